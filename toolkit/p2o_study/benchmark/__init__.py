"""The benchmark: suites, rows of results as JSON lines, external methods, bundles and tables."""
