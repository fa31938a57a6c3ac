"""PTX: stations of laser scanners as text, each with its pose."""
