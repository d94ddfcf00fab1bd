"""What a step costs here and elsewhere; run the scripts, see README.md."""
