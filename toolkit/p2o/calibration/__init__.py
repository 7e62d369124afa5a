"""Algorithm 1 of the paper: proposals, rounds of matching and solving, the judge, and the nuisance parameters."""
