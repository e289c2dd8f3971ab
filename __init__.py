"""Measure, fit and render light under the surface of translucent materials (Jensen et al. 2001)."""

__version__ = "0.1.0"
