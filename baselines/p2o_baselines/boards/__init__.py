"""Boards that both sensors see: found in picture and sweep, told apart, and what each says about the pose."""
