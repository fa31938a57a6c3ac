"""One thread for torch: the tests share their machine, and results do not depend on the number of cores."""

import torch

torch.set_num_threads(1)
