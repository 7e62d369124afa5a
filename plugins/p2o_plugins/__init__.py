"""The methods of P2O-Calib and those it is compared with, as plugins like any other."""
