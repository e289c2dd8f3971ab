"""The file formats, version 1: data classes in `records`, and a module for each reader and writer."""
