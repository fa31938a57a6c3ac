"""Tours of photos with known poses, placed as people place theirs: what is right, how long it takes, and what it takes of memory."""
