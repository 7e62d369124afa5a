"""Networks that regress an extrinsic: decalibration, projected sweeps, labels, training and staged inference."""
