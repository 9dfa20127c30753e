"""Sender and receiver: sources, playout, decoding, drawing, and the shells around them."""

import os

# One thread for numpy's products of matrices, unless the user has chosen: they are small, and on a
# busy machine two that wait for each other take a hundred times as long as one. Read by OpenBLAS
# when numpy is imported first.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
