"""What was decoded once is decoded for ever: conformance/make/promise.py. That vectors decode to it is the runner's to check."""

import pytest

from conformance.make.promise import HOME, broken, changed, current, promised, renewed

OLD = {"subset/a": ["1", "2"], "subset/b": ["3", "4"]}


def test_every_stream_that_decodes_is_promised_and_as_it_was():
    assert promised() == current() and len(current()) > 150
    kinds = [name.split("/")[0] for name in promised()]
    assert kinds.count("real") >= 12 and kinds.count("container") > 20


@pytest.mark.parametrize("new, said", [({"subset/a": ["1", "2"]}, "subset/b is gone"),
                                       (OLD | {"subset/a": ["0", "2"]}, "subset/a is another stream"),
                                       (OLD | {"subset/a": ["1", "0"]}, "subset/a decodes to other values")])
def test_a_promise_is_not_broken(new, said):
    assert list(broken(OLD, new)) == [said]
    with pytest.raises(ValueError, match=said):
        renewed(OLD, new)


def test_new_vectors_join_the_list():
    assert renewed(OLD, OLD | {"subset/c": ["5", "6"]}) == OLD | {"subset/c": ["5", "6"]}


def test_a_promised_vector_is_not_made_anew():
    data = (HOME / "subset/k3/in.texf").read_bytes()
    assert changed({"subset/k3": data, "subset/new": b""}) == []
    assert changed({"subset/k3": data[:-1], "subset/new": b""}) == ["subset/k3"]
