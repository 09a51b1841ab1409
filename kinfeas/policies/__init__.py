"""Base policies: networks, ONNX files, baselines and loading by name. May import control."""
