import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mapmend.io._decimals import format_rows, parse, tokenize

_plain = st.decimals(allow_nan=False, allow_infinity=False, places=None).map(lambda d: f"{d:f}"[:24])
_words = st.one_of(
    st.floats().map(repr),
    st.floats(-1e6, 1e6).map(lambda x: f"{x:.2f}"),
    st.floats(-1e6, 1e6).map(lambda x: f"{x:.7f}"),
    _plain,
    st.text("0123456789.+-eE_,/:*", min_size=1, max_size=18),
)


def _expected(word: str) -> float | None:
    try:
        return None if "_" in word else float(word)
    except ValueError:
        return None


@settings(max_examples=400)
@given(st.lists(_words, min_size=1, max_size=30))
@example(
    ["1.2.3", "-", ".", "-.", "1-2", "1,5", "12345678.12345678", "0.12345678901234", ".5", "5.", "+1", "9" * 16, "nan"]
)
def test_words_have_the_value_that_float_gives_them(words):
    values, valid = parse(tokenize([" ".join(words).encode()]))
    for word, value, ok in zip(words, values.tolist(), valid.tolist(), strict=True):
        expected = _expected(word)
        assert ok == (expected is not None), word
        if expected is not None:
            np.testing.assert_equal(value, expected)


@settings(max_examples=60)
@given(st.integers(0, 2**32), st.integers(-30, 25))
def test_many_long_words_have_the_value_that_float_gives_them(seed, exponent):
    generator = np.random.default_rng(seed)
    numbers = generator.normal(size=200) * 10.0**exponent
    # Ties between two doubles, and what lies a digit beside them.
    whole = 2**53 + 2 * generator.integers(0, 2**52, 50) + 1
    words = [repr(float(x)) for x in numbers] + [f"{x:.17e}" for x in numbers] + [str(x) for x in whole]
    words += [f"{x}.{'0' * (x % 4 // 2)}{x % 9}" for x in whole.tolist()]
    words += ["1.5x", "nan", "-inf", "1_000", "1e400", "-0.0", "0.00", "+2.50000000000000000", "18446744073709551616"]
    values, valid = parse(tokenize([" ".join(words).encode()]))
    expected = [_expected(word) for word in words]
    assert valid.tolist() == [value is not None for value in expected]
    np.testing.assert_array_equal(values[valid], [value for value in expected if value is not None])
    assert np.signbit(values[len(words) - 4])


def test_lines_keep_their_words():
    tokens = tokenize([b"1 2", b"", b"  3\t4 5\r"])
    assert tokens.counts().tolist() == [2, 0, 3]
    assert parse(tokens)[0].tolist() == [1.0, 2.0, 3.0, 4.0, 5.0]


@settings(max_examples=100)
@given(st.lists(st.floats(np.float32(1e-4), np.float32(900.0), width=32), min_size=1, max_size=20), st.integers(2, 4))
def test_formatted_ranges_read_back_to_the_last_bit(ranges, least):
    ranges = np.array(ranges, np.float32)
    (text,) = format_rows(ranges, np.array([0, len(ranges)]), np.array([1000.0]), least)
    assert [np.float32(word) for word in text.split()] == ranges.tolist()


def test_readings_are_as_short_as_they_can_be():
    ranges = np.array([12.34, 0.5, np.inf, np.nan, 7.0], np.float32)
    rows = format_rows(ranges, np.array([0, 2, 2, 5]), np.array([30.0, 30.0, 81.83]))
    assert rows == [b" 12.34 0.50", b"", b" 81.83 0.00 7.00"]


def test_no_return_is_never_rounded_below_the_maximum():
    (row,) = format_rows(np.array([np.inf, 1.25], np.float32), np.array([0, 2]), np.array([29.9999901]))
    assert row == b" 30.00 1.25"
    (row,) = format_rows(np.array([np.inf], np.float32), np.array([0, 1]), np.array([30.0000001]))
    assert float(row) >= 30.0000001
