"""What is made of a run to look at: figures."""
