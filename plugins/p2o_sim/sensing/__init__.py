"""Simulated sensors and their motion: LiDARs, cameras, weather, trajectories and rigs."""
