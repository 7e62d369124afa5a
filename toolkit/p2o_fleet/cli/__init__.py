"""The command of the fleet package."""
