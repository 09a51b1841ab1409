"""Recipes: YAML files by path, such as `train/pr2.yaml`."""
