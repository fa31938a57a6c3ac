"""Tables of numbers as text: XYZ, PTS, CSV."""
