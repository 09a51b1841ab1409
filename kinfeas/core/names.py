"""Names of robots and tasks, which tables, file names and errors carry."""


def check_name(name: str) -> None:
    """Do nothing if `name` can stand in a line and in a file name.

    Raises:
        ValueError: If it is empty, or has a `/` or a control character.
    """
    if not name.strip() or "/" in name or not name.isprintable():
        raise ValueError(f"'name' must be printable, not empty and without '/', not {name!r}")
