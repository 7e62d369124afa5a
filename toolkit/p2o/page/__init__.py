"""HTML pages: one description as data, one template, style sheet and script, and one kind of plots."""
