"""What each command shows, as plain data: one file per subject."""
