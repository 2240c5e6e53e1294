"""Planes of whole numbers as short text, for page/decode.js to read back: prediction, contexts and zlib.

Every number is predicted from its neighbours above and to the left. What is left over goes into one of ten streams, by
how much those neighbours differ among each other, so that flat and busy places do not share a Huffman table (the idea
of CALIC: Wu and Memon, "Context-based, adaptive, lossless image coding", IEEE Transactions on Communications 45, 1997).
A browser has a decoder for zlib; an image codec of a browser would give 8 bits a channel.
"""

from __future__ import annotations

import base64
import struct
import zlib

import numpy as np

CONTEXTS = 10
#: Symbols that stand for what has no byte: one byte more, or two.
ONE_MORE, TWO_MORE = 254, 255
#: More than what is left over of any two numbers of `quantise`.
LARGEST = ONE_MORE + 256 + 65535


def encode(plane: np.ndarray) -> bytes:
    """(H, W) of whole numbers as bytes.

    Raises:
        OverflowError: neighbours differ by too much, which numbers of up to 13 000 never do.

    Example:
        >>> plane = np.arange(12).reshape(3, 4)
        >>> bool((decode(encode(plane), 3, 4) == plane).all())
        True
    """
    plane = np.asarray(plane, np.int32)
    west, north, north_west, north_east = _neighbours(plane)
    guesses = _guesses(west, north, north_west, north_east)
    # Every fourth row tells as much as all of them.
    kind = min(range(len(guesses)), key=lambda k: np.log2(1 + np.abs((plane - guesses[k])[::4])).sum())
    left = (plane - guesses[kind]).ravel()
    folded = np.where(left < 0, -2 * left - 1, 2 * left)
    if folded.max(initial=0) > LARGEST:
        raise OverflowError(
            f"a number is {np.abs(left).max()} from what its neighbours let expect: {LARGEST // 2} is the most"
        )
    one, two = (folded >= ONE_MORE) & (folded < ONE_MORE + 256), folded >= ONE_MORE + 256
    symbols = np.where(two, TWO_MORE, np.where(one, ONE_MORE, folded)).astype(np.uint8)
    contexts = _contexts(west, north, north_west, north_east).ravel()
    body = b"".join(
        (
            struct.pack("<B", kind),
            np.bincount(contexts, minlength=CONTEXTS).astype("<u4").tobytes(),
            struct.pack("<I", np.count_nonzero(one)),
            symbols[np.argsort(contexts, kind="stable")].tobytes(),
            (folded[one] - ONE_MORE).astype(np.uint8).tobytes(),
            (folded[two] - ONE_MORE - 256).astype("<u2").tobytes(),
        )
    )
    return min((_deflated(body, strategy) for strategy in (zlib.Z_DEFAULT_STRATEGY, zlib.Z_HUFFMAN_ONLY)), key=len)


def decode(data: bytes, height: int, width: int) -> np.ndarray:
    """What `encode` was given, (height, width) int32: slow and plain, the pattern for decode.js.

    Example:
        >>> decode(encode(np.array([[7, -300, 20000]])), 1, 3).tolist()
        [[7, -300, 20000]]
    """
    body = zlib.decompress(data)
    kind, counts = body[0], np.frombuffer(body, "<u4", CONTEXTS, 1)
    ones = struct.unpack_from("<I", body, 1 + 4 * CONTEXTS)[0]
    start = 5 + 4 * CONTEXTS
    at = start + np.cumsum(counts) - counts
    one = start + height * width
    two = one + ones
    padded = np.zeros((height + 1, width + 2), np.int64)
    for y in range(1, height + 1):
        padded[y, 0] = padded[y - 1, 1]
        for x in range(1, width + 1):
            around = padded[y, x - 1], padded[y - 1, x], padded[y - 1, x - 1], padded[y - 1, x + 1]
            context = int(_contexts(*around))
            value = body[at[context]]
            at[context] += 1
            if value == ONE_MORE:
                value += body[one]
                one += 1
            elif value == TWO_MORE:
                value = ONE_MORE + 256 + struct.unpack_from("<H", body, two)[0]
                two += 2
            left = -(value + 1) // 2 if value % 2 else value // 2
            padded[y, x] = _guesses(*around)[kind] + left
        padded[y, width + 1] = padded[y, width]
    return padded[1:, 1:-1].astype(np.int32)


def as_text(data: bytes) -> str:
    """Bytes as text that can stand in a `<script>`: base 85 with / for <, so that no tag can begin in it."""
    return base64.b85encode(data).replace(b"<", b"/").decode("ascii")


def _neighbours(plane: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """West, north, north-west, north-east; 0 above the image, the one above to its left, the last one to its right."""
    padded = np.pad(plane, ((1, 0), (1, 1)))
    padded[1:, 0] = padded[:-1, 1]
    padded[:, -1] = padded[:, -2]
    return padded[1:, :-2], padded[:-1, 1:-1], padded[:-1, :-2], padded[:-1, 2:]


def _guesses(west, north, north_west, north_east) -> tuple:
    """Three predictions: along edges (the median of LOCO-I), along slopes (that of CALIC), and for noise the mean."""
    low, high = np.minimum(west, north), np.maximum(west, north)
    edge = np.where(north_west >= high, low, np.where(north_west <= low, high, west + north - north_west))
    slope = (2 * (west + north) + north_east - north_west + 2) >> 2
    return edge, slope, (west + north + north_west + north_east + 2) >> 2


def _contexts(west, north, north_west, north_east) -> np.ndarray:
    """How many bits the differences between the neighbours have, at most 9."""
    differences = np.abs(west - north_west) + np.abs(north - north_west) + np.abs(north - north_east)
    bits = np.frexp(np.asarray(differences, np.float64))[1]
    return np.minimum(bits, CONTEXTS - 1).astype(np.uint8)  # a byte is sorted fastest


def _deflated(body: bytes, strategy: int) -> bytes:
    packer = zlib.compressobj(6, zlib.DEFLATED, 15, 8, strategy)
    return packer.compress(body) + packer.flush()
