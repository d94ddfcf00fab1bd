"""Models that cost next to nothing, so that what is measured is what steps them."""
