"""The conformance kit: checks that any method of a slot has to pass, for our own plugins and everyone's.

In the tests of a plugin:

    import pytest
    from p2o_testing import conformance_cases

    @pytest.mark.parametrize("check", conformance_cases("my-distribution"))
    def test_conformance(check):
        check()

Names are imported on first use: the commands of this package are listed without them.
"""

# isort: skip_file

from __future__ import annotations

from typing import TYPE_CHECKING

from p2o.runtime.lazy import attach

if TYPE_CHECKING:
    from p2o_testing import stage as stage
    from p2o_testing.cases import Case as Case, checks_for as checks_for, conformance_cases as conformance_cases
    from p2o_testing.cases import reads_files as reads_files
    from p2o_testing.checks import CHECKS as CHECKS
    from p2o_testing.subject import Check as Check, CheckFailed as CheckFailed, NotApplicable as NotApplicable
    from p2o_testing.subject import Subject as Subject

__getattr__, __dir__, __all__ = attach(__name__, __file__)
