"""`python -m kinfeas`: the command `kinfeas`, where its folder is not on the path."""

from kinfeas.cli.main import main

if __name__ == "__main__":
    main()
