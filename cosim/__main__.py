"""``python -m cosim``: the command, where the script ``cosim`` is not on the path."""

from cosim.cli import main

if __name__ == "__main__":
    main()
