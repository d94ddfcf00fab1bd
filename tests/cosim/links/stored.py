"""Tables as files."""

from cosim.links.storage import GROUP, TableWriter


def save_table(path, table, length):
    """The first `length` rows of a table as a file."""
    stream = table.stream(length)
    with TableWriter(path, table.facts()) as writer:
        for start in range(0, length, GROUP):
            writer.write(stream.rows(min(GROUP, length - start)))
