"""What Mitsuba's errors say, in one line."""


def cause(error: Exception) -> str:
    """The last line of the message, which names the cause."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[-1] if lines else repr(error)
