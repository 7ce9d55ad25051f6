"""What operation does to the product: ``python -m bench chaos [PART ...] [--size N] [--short] [--seed N] ...``."""
