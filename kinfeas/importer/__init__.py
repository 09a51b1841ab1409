"""A robot's files from its URDF: primitives for its meshes, and a YAML file to look through."""
