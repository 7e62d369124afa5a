"""Checks of the extrinsics of a fleet of vehicles: runs, stored evidence, sequential tests, alarms and pages."""
