"""Mutated inputs for every door of p2o, each run in a process of its own with limits: `make fuzz`.

docs/reliability.md says what is promised; `contract` checks it.
"""
