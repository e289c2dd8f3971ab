"""The commands, one module a subject: each parses, calls one function, prints its result and sets the exit code."""
