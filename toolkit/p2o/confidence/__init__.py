"""How far a pose can be believed: predicted errors, agreement of edges, verdicts, and checks of a given extrinsic."""
