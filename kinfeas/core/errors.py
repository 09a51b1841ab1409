"""The one exception that a user causes and a user can mend."""


class KinfeasError(ValueError):
    """Bad input: a file, key, value, URDF, plugin or policy.

    The message is one sentence that names what is wrong and what is allowed. The command line
    prints it without a traceback and exits with code 2.
    """
