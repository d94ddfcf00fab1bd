"""Random formulas of the signals ``a.x`` and ``b.x``, and rows of these."""

from __future__ import annotations

from hypothesis import strategies as st

SIGNALS = ("a.x", "b.x")


def _comparison() -> st.SearchStrategy[str]:
    return st.builds(
        "{} {} {} m".format,
        st.sampled_from(SIGNALS),
        st.sampled_from(["<=", ">="]),
        st.integers(-3, 3).map(float),
    )


def interval(*, unbounded: bool = True) -> st.SearchStrategy[str]:
    """A text of an interval, in whole s."""
    pairs = st.tuples(st.integers(0, 4), st.integers(0, 5))
    kinds = [
        pairs.map(lambda x: f"within [{x[0]} s, {x[0] + x[1]} s]"),
        st.integers(0, 5).map("within {} s".format),
    ]
    if unbounded:
        kinds += [st.just(""), st.integers(0, 3).map("after {} s".format)]
    return st.one_of(kinds)


def formulas(*, unbounded: bool = True, until: bool = True) -> st.SearchStrategy[str]:
    """Texts of formulas."""
    window = interval(unbounded=unbounded)

    def nested(inner: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
        kinds = [
            st.builds("not ({})".format, inner),
            st.builds(
                "({}) {} ({})".format, inner, st.sampled_from(["and", "or", "implies"]), inner
            ),
            st.builds("always {} ({})".format, window, inner),
            st.builds("eventually {} ({})".format, window, inner),
        ]
        if until:
            kinds.append(st.builds("({}) until {} ({})".format, inner, window, inner))
        return st.one_of(kinds)

    return st.recursive(_comparison(), nested, max_leaves=4)


def values(size: int) -> st.SearchStrategy[list[float]]:
    """`size` rows of a signal."""
    return st.lists(st.integers(-5, 5).map(float), min_size=size, max_size=size)
