"""Commands that the training package adds to `p2o`; the code of each is in `p2o_train.cli`."""

COMMANDS = {
    "labels": "Write the training labels of frames, one file per frame.",
    "train": "Train a method on frames, or resume a training.",
}
"""Name and one-line help of every command."""
