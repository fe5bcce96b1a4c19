"""Datasets and runs by URL: object stores, and the local folders that mirror them."""
