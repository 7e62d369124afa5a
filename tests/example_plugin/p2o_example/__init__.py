"""A plugin of p2o as a third party would write it."""
