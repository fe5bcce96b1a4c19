"""Synthetic streets and their flawed twins."""
