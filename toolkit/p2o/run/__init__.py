"""One run: the words, the recipe, what fits together, frames in and results out."""
