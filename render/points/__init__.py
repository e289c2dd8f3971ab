"""Light that enters bodies, stored on their surface, and what of it leaves where. Lengths in scene units."""
