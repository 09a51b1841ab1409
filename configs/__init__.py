"""Configuration in YAML: `robots`, one file each with sections; `paper`, `benchmark`, `sim2real`.

`kinfeas.config.recipes` reads the files by name.
"""
