"""Kinds of scenes, drawn at random: streets, roads, yards, halls and rooms."""
