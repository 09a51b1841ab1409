"""Configuration in YAML: `default.yaml` for any robot; `paper`, `benchmark`, `sim2real`, `sweep`.

`kinfeas.config.recipes` reads the files by name.
"""
