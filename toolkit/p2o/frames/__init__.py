"""What sensors gave: images, sweeps, and frames that join them; how frames are chosen."""
