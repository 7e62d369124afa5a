"""What extractors find, and views that hold it: kinds of features, each of which knows how it moves."""
