"""Write simulated frames in the layouts of data sets."""
