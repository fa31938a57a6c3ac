"""Whole scenes: rooms, flats, streets and twins, their light, and how they change."""
