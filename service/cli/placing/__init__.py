"""`panoloc place` and `panoloc export`: a folder of photos placed one by one, and written in the formats of other systems."""
