"""Whether results told the truth about themselves is counted from single rows, rotations and translations apart."""

from __future__ import annotations

from dataclasses import replace

from p2o.results.verdict import Trust
from p2o_study.coverage import BoundCoverage, bound_coverage, false_accepts, pooled
from p2o_study.store import StoredRow
from p2o_study.study import parse_study
from p2o_study.tally import table, tallies

ROW = StoredRow(
    "k", "s", "a", frames=("f",), status="converged", trust=Trust.TRUSTED, rotation_deg=0.3, translation_m=0.05,
    figures={
        "predicted_rotation_deg": 0.2, "predicted_translation_m": 0.06,
        "predicted_rotation_deg_95": 0.4, "predicted_translation_m_95": 0.12,
    },
)  # fmt: skip
STUDY = parse_study(
    'name = "s"\ntitle = "S"\n[[dataset]]\nname = "d"\ndata = "d:"\n[[row]]\nlabel = "a"\ncalibrator = "quick"'
)


def test_rotations_and_translations_are_held_each_to_its_own_bounds() -> None:
    """The first is over its first bound in rotation only; the second over both bounds of both; the third at them."""
    far = replace(ROW, rotation_deg=0.5, translation_m=0.2)
    at = replace(ROW, rotation_deg=0.2, translation_m=0.06)
    found = bound_coverage([ROW, far, at])
    assert found == BoundCoverage(3, rotation=1, translation=2, rotation_95=2, translation_95=2)
    assert (found.text_67, found.text_95) == ("1/3 2/3", "2/3 2/3")


def test_who_promised_nothing_or_has_no_truth_is_not_counted() -> None:
    refused = replace(ROW, status="no-edges")
    silent = replace(ROW, figures={})
    unknown = replace(ROW, rotation_deg=None, translation_m=None)
    assert bound_coverage([refused, silent, unknown]) == BoundCoverage(0, 0, 0, 0, 0)
    assert bound_coverage([]).text_67 == "-"
    boundless = replace(ROW, figures={**ROW.figures, "predicted_rotation_deg": float("inf")})
    assert bound_coverage([boundless]).rotation == 1


def test_trusted_and_wrong_is_far_off_in_either_and_called_trusted() -> None:
    turned, shifted = replace(ROW, rotation_deg=1.01), replace(ROW, translation_m=0.31)
    doubted = replace(turned, trust=Trust.DOUBTFUL)
    just_right = replace(ROW, rotation_deg=1.0, translation_m=0.3)
    assert false_accepts([ROW, turned, shifted, doubted, just_right, replace(turned, trust=None)]) == 2


def test_the_table_has_columns_for_it_and_tells_of_all_rows_below() -> None:
    wrong = replace(ROW, key="w", row="b", rotation_deg=1.5, translation_m=0.05)
    [first, second] = tallies([ROW, wrong], STUDY.metrics)
    assert (first.coverage.rotation, second.coverage.rotation_95) == (0, 0)
    assert (first.false_accepts, second.false_accepts) == (0, 1)
    head, a, b, *below = table(STUDY, [ROW, wrong]).splitlines()
    for title, cells in (
        ("false accepts", "01"),
        ("coverage 67 %", ("0/1 1/1",) * 2),
        ("coverage 95 %", ("1/1 1/1", "0/1 1/1")),
    ):
        end = head.index(title) + len(title)
        assert all(line[:end].endswith(f"  {cell}") for line, cell in zip((a, b), cells, strict=True)), title
    assert below == [
        "Coverage of the predicted errors of 2 runs: 0 % of rotations and 100 % of translations (67 % expected), "
        "50 % of rotations and 100 % of translations (95 % expected)",
        "Trusted: 2 runs, 1 of them with an error above 1 deg or 30 cm",
    ]


def test_a_study_whose_results_say_nothing_of_the_kind_has_no_such_columns() -> None:
    bare = replace(ROW, trust=None, figures={})
    text = table(STUDY, [bare])
    assert "coverage" not in text.lower()
    assert "rusted" not in text
    assert pooled([bare]) == []
