"""A vector as the makers list it, and the sentence of its claims."""

from dataclasses import dataclass

EXPECTED = {"S": "invalid", "U": "unsupported", "L": "limit"}  # by the letter of the code


@dataclass
class Vector:
    """One case. name: kind and folder; title: what it is, of a good one its claims; claims: keys of claims.CLAIMS, alone or as
    (key, argument, ...); clauses: what it was made for; lods: decoded levels of detail, none where it is faulty; expect, code:
    how it is to be refused."""

    name: str
    title: str
    clauses: tuple
    data: bytes
    lods: tuple = (0,)
    expect: str = ""
    code: str = ""
    claims: tuple = ()


def good(kind, name, claims, clauses, data, lods=(0,)):
    """Vector of a maker's row."""
    return Vector(f"{kind}/{name}", title_of(claims), clauses, data, lods, claims=tuple(claims))


def faulty(name, title, clause, data, code):
    """Vector of a maker's row."""
    return Vector(f"faulty/{name}", title, (clause,), data, (), EXPECTED[code[4]], code)


def in_full(claim):
    """(key, argument, ...) of a claim, which may be a key alone."""
    return (claim,) if isinstance(claim, str) else tuple(claim)


def title_of(claims):
    """The sentence of claims."""
    return ", ".join(key.format(*arguments) for key, *arguments in map(in_full, claims))
