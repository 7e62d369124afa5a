"""The tests of the simulator render every frame."""

from tests.rendered_frames import frames_are_rendered

__all__ = ["frames_are_rendered"]
