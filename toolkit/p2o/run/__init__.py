"""One run: the recipe, the methods that it names, frames in and results out."""
