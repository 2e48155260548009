"""tools/proof/walk.py: an argument is followed where it goes, and the request of an encode does not wander."""

import pytest

from tools.proof.walk import PACKAGE, Package, Walk

FILES = {
    "ground.py": "def deepest(thing, number): return thing\ndef never(thing): return 1\n",
    "middle.py": "from .ground import deepest\nclass Keeper:\n    def __init__(self, thing):\n        self.thing = thing\n"
                 "    def use(self):\n        return deepest(self.thing, 3)\n",
    "top.py": "from .ground import never\nfrom .middle import Keeper\ndef start(thing, other):\n    keeper = Keeper(thing)\n"
              "    never(other)\n    return again(thing.size)\ndef again(thing): return never(thing)\n",
}


@pytest.fixture
def package(tmp_path):
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    return Package(tmp_path)


def test_floors_follow_the_imports(package):
    assert package.floors == {"ground.py": 0, "middle.py": 1, "top.py": 2}


def test_an_argument_is_followed_and_what_is_read_from_it_is_not(package):
    walk = Walk(package, "top.py", "start", "thing")
    assert walk.stays == ["top.py", "middle.py", "top.py"] and walk.climbs == 1  # never() gets another, again() its size


def test_what_was_kept_in_an_attribute_is_followed_from_there(package):
    Walk(package, "middle.py", "__init__", "thing")
    (package.root / "top.py").write_text("from .middle import Keeper\nfrom .ground import deepest\n"
                                         "def start(thing):\n    keeper = Keeper(thing)\n    deepest(keeper.thing, 1)\n")
    walk = Walk(Package(package.root), "top.py", "start", "thing")
    assert walk.kept == {"thing"} and walk.stays == ["top.py", "middle.py", "top.py", "ground.py", "top.py"] and walk.climbs == 2


def test_the_request_of_an_encode_passes_few_files_and_seldom_climbs():
    walk = Walk(Package(PACKAGE), "encoder/pipeline.py", "encode_scene", "options")
    assert "encoder/plan.py" in walk.files and len(walk.files) <= 24, walk.files
    assert walk.climbs <= 8, walk.stays
