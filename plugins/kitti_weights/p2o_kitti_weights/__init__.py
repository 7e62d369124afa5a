"""Weights that were trained on KITTI, for research only (CC BY-NC-SA 3.0): METHOD-NAME.safetensors."""
