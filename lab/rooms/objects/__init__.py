"""Solids, and what is built from them: furniture, fittings, walls, and where they are put."""
