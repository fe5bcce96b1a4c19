"""What data looks like: tables, settings, errors. Imports no other room."""
