"""Geometry without data: rigid transforms, cameras, motion, errors of poses."""
