"""The output of each command as plain data: one file per subject."""
