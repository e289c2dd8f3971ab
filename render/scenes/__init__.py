"""Scenes built in code, one module a family, as descriptions that no renderer needs to be installed for."""
