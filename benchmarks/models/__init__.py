"""Models with a negligible cost, so that the cost of the engine is measured."""
