"""Datasets and runs by URL: object stores, and the local folders that mirror them. What the core uses is named here."""

from .object_store import describe_object, read_object
from .remote_dataset import fetched_scan, stubs_of
from .remote_run import folder_of_worker, local_of, share_folder

__all__ = ["describe_object", "fetched_scan", "folder_of_worker", "local_of", "read_object", "share_folder", "stubs_of"]
