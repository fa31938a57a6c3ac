"""One thread for torch, and no clock over single examples: the tests share their machine."""

import torch
from hypothesis import settings

torch.set_num_threads(1)
settings.register_profile("shared machine", deadline=None, derandomize=True, max_examples=60)
settings.load_profile("shared machine")
