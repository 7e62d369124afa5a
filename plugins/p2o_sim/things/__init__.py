"""Things of a scene: houses, furniture, vehicles, people, plants and calibration targets."""
