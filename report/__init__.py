"""What people read: the material table, a fit in words, figures, progress."""
