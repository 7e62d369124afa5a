"""Commands that the study package adds to `p2o`; the code of each is in `p2o_study.cli`."""

COMMANDS = {
    "ablate": "Run a study: methods x frames x starts, as a table that can be resumed and gated.",
    "benchmark": "Measure suites as rows of data, compute rows again, score external methods, write tables and a page.",
    "compare": "Compare methods on your own frames without ground truth: repeatability, agreement, ranking.",
    "report": "Write tables, figures and one page about the studies in a folder.",
}
"""Name and one-line help of every command."""
