"""One query on its way: the rig and each map made ready, refined, judged."""
