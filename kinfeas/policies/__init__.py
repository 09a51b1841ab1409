"""Base policies: networks, ONNX files, baselines, and loading by name.

May import control and lower packages. A robot's computer needs this package, but not torch.
"""
