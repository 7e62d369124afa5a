"""Commands of the package for plugin authors and installations."""
