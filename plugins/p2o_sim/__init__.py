"""Simulator of cameras and LiDARs: all sensors observe the same scene, with exact ground truth.

The public names are listed in `__init__.pyi`; each is imported when it is first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
