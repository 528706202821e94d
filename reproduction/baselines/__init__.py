"""Methods that Section 5.1 compares with; the main path knows nothing of them."""
