"""How the scores depend on the settings."""
