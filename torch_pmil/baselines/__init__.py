"""Other ways to imitate, which the paper compares with."""
