"""P2ORNet: the network that labels directed occlusion edges, its labels and its training."""
