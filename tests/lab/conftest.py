"""Runs commands against the fake service."""

from tests.service.cli.commands import fake, panoloc, panorama, scan

__all__ = ["fake", "panoloc", "panorama", "scan"]
