"""What networks that regress an extrinsic share: wrong starts, sweeps as pictures, labels, training, staged use."""
