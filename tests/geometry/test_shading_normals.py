"""Shading normals that the stream stands for: rules, angles, marks of sharp edges, and what the encoder chooses."""

from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from conftest import REPOSITORY
from shapes import hand, scene_of, sphere

from conformance.reference.edges import fold as naive_fold
from conformance.reference.edges import marked_edges
from texfcodec import DecodeOptions, EncodeOptions, Report, decode
from texfcodec.bitstream.inspect import inspect
from texfcodec.codecs.sharp_edges import dec_marks, enc_marks
from texfcodec.encoder.decide.channel_weights import SHADING
from texfcodec.encoder.decide.normal_rules import ENOUGH, LEAST_STEP, STEP, choose_normals, quantiles
from texfcodec.encoder.pipeline import encode_scene
from texfcodec.geometry.edges import MANY, NUM_FOLDS, coded_edges, folds, shared_edges, weld
from texfcodec.geometry.shading_normals import corner_normals
from texfcodec.geometry.surface import make_surface
from texfcodec.io.load import load
from texfcodec.scene.normal_rule import ANGLE, AREA, BOTH, FLAT, IN_STREAM, JOINED, MARKED, USUAL, NormalRule
from texfcodec.scene.scene import Material

SMALL = EncodeOptions(resolution=32, qp=40, threads=1)


def with_normals(positions, faces, normals, **more):
    """A Scene of vertex normals [V, 3] or corner normals [F, 3, 3]."""
    scene = scene_of(positions, faces, **more)
    normals = np.asarray(normals, np.float32)
    scene.corner_normal, scene.flat = normals[faces] if normals.ndim == 2 else normals, True
    return scene


def chosen(scene, report=None):
    """(Shading, Surface) of a scene on a lattice of 14 bits."""
    surface = make_surface(scene, EncodeOptions())
    decision = choose_normals(scene, surface)
    if report is not None:
        report.warnings += decision.warnings
    return SimpleNamespace(**vars(decision.value), evidence=decision.evidence), surface


def degrees(a, b):
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(-1)))


def naive_normals(lattice, faces, rules, face_rule, sharp):
    """Clause 8.4.1 word by word: float64 [F, 3, 3]. sharp: set of pairs of positions."""
    places = [[tuple(lattice[v].tolist()) for v in face] for face in faces]
    corners = lattice[faces].astype(np.float64)
    crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(crosses, axis=1)
    units = [cross / area if area > 0 else cross for cross, area in zip(crosses, areas, strict=True)]
    at, edge_faces, out = {}, {}, np.zeros((len(faces), 3, 3))
    for f, face in enumerate(places):
        for c in range(3):
            at.setdefault(face[c], []).append((f, c))
            if len(set(face)) == 3:
                edge_faces.setdefault(frozenset((face[c], face[c - 1])), []).append(f)

    def weight(f, c, kind):
        u, v = corners[f, c - 2] - corners[f, c], corners[f, c - 1] - corners[f, c]
        angle = np.arctan2(np.linalg.norm(np.cross(u, v)), u @ v)
        return (areas[f], angle, areas[f] * angle)[kind]

    def near(f, g, angle):
        return angle == 180 or units[f] @ units[g] >= np.cos(np.radians(angle)) - 1e-9

    def reached(f, place, rule):
        seen, ahead = {f}, [f]
        while ahead:
            g = ahead.pop()
            for edge in [e for e in edge_faces if place in e and g in edge_faces[e]]:
                free = 2 <= len(edge_faces[edge]) <= 8 and not (rule.kind == MARKED and edge in sharp)
                for h in edge_faces[edge] if free else []:
                    if h not in seen and units[g] @ units[h] >= np.cos(np.radians(rule.angle)) - 1e-9:
                        seen.add(h)
                        ahead.append(h)
        return seen

    for place, around in at.items():
        for f, c in around:
            rule = rules[face_rule[f]]
            if rule.angle == 0:
                wanted = set()
            else:
                wanted = reached(f, place, rule)
            parts = [(weight(g, d, rule.weight), units[g]) for g, d in around if g in wanted]
            total = sum((w * unit for w, unit in parts), np.zeros(3))
            total = total if np.linalg.norm(total) > 1e-9 * sum(w for w, _ in parts) else units[f]
            length = np.linalg.norm(total)
            out[f, c] = total / length if length > 0 else (0, 0, 1)
    return out


# The kernels against their oracles


@pytest.mark.parametrize("seed", range(4))
def test_rules_agree_with_the_slow_ones_on_random_surfaces(seed):
    rng = np.random.default_rng(seed)
    positions, faces = sphere(5)
    lattice = np.rint((positions + rng.normal(0, 0.12, positions.shape)) * 4000).astype(np.int64) + 20000
    faces = np.concatenate([faces, faces[:6], faces[6:9, ::-1], [[0, 1, 1], [3, 40, 9], [5, 11, 2]]])  # doubled, turned, odd
    every = [NormalRule(kind, weight, angle) for kind in (JOINED, MARKED) for weight in (AREA, ANGLE, BOTH)
             for angle in (0, 20, 45, 90, 180)]
    face_rule = rng.integers(0, len(every), len(faces))
    marked = np.array([rule.kind == MARKED for rule in every])[face_rule]
    ends, _ = coded_edges(lattice, faces, marked)
    marks = rng.random(len(ends)) < 0.4
    where = {number: tuple(place) for number, place in zip(weld(lattice).tolist(), lattice.tolist(), strict=True)}
    sharp = {frozenset((where[a], where[b])) for a, b in ends[marks].tolist()}
    got = corner_normals(lattice, faces, every, face_rule, marks)
    assert np.quantile(degrees(got, naive_normals(lattice, faces, every, face_rule, sharp)), 1) < 0.1


@pytest.mark.parametrize("bits", [8, 14, 20])
def test_folds_and_edges_agree_with_the_slow_ones(bits):
    rng = np.random.default_rng(bits)
    lattice = rng.integers(0, 1 << bits, (60, 3))
    lattice[50:] = lattice[:10]  # positions that are there twice
    faces = np.concatenate([rng.integers(0, 60, (300, 3)), [[0, 1, 2]] * 9])
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    materials, material = [{"normal_rule": 3}, {"normal_rule": 0}], rng.integers(0, 2, len(faces))
    units = [{"material": m, "lattice": lattice.tolist(), "faces": faces[material == m].tolist()} for m in (0, 1)]
    slow = marked_edges(units, materials)
    order = np.concatenate([np.flatnonzero(material == m) for m in (0, 1)])
    ends, fold = coded_edges(lattice, faces[order], material[order] == 0)
    numbers = {tuple(place[::-1]): number for number, place in zip(weld(lattice).tolist(), lattice.tolist(), strict=True)}
    assert ends.tolist() == [[numbers[a], numbers[b]] for (a, b), _ in slow]
    assert fold.tolist() == [naive_fold(triangles) for _, triangles in slow]
    assert {MANY} < set(fold.tolist()) and fold.max() < NUM_FOLDS


def test_an_edge_is_classed_whatever_the_order_of_faces_and_corners():
    positions, faces = sphere(6)
    lattice = np.rint(positions * 300).astype(np.int64) + 400
    rng = np.random.default_rng(2)
    turned = np.stack([np.roll(face, rng.integers(3)) for face in rng.permutation(faces)])
    edges, others = (shared_edges(weld(lattice)[f]) for f in (faces, turned))
    assert np.array_equal(edges.ends, others.ends)
    assert np.array_equal(folds(edges, lattice, faces), folds(others, lattice, turned))


@pytest.mark.parametrize("share", [0, 0.02, 0.5, 1.1])
def test_marks_come_back(share):
    positions, faces = sphere(20)
    lattice = np.rint(positions * 4000).astype(np.int64) + 5000
    ends, fold = coded_edges(lattice, faces, np.ones(len(faces), bool))
    marks = np.random.default_rng(1).random(len(ends)) < share
    data = enc_marks(marks, ends, fold)
    assert np.array_equal(dec_marks(data, ends, fold), marks)
    assert len(data) < (0.02 if share in (0, 1.1) else 0.17) * len(ends)
    assert len(dec_marks(b"", ends, fold)) == len(ends)  # whatever the bytes: some marks


# What the encoder chooses


def test_a_smooth_hand_comes_back_within_three_tenths_of_a_degree():
    positions, faces, _ = hand(64)
    smooth = trimesh.Trimesh(positions, faces, process=False).vertex_normals  # what exporters write
    scene = with_normals(positions, faces, smooth)
    made = encode_scene(scene, SMALL)
    texf = decode(made.data)
    told = made.choices["normals"]
    assert told["degrees"][2] < 0.3 and told["usual_rule_degrees"][2] > 10 * told["degrees"][2] and "marks_bytes" not in told
    where = {tuple(place): normal for place, normal in zip(texf.cube.to_lattice(positions).tolist(), smooth, strict=True)}
    source = np.array([where[tuple(place)] for place in texf.lattice_positions.tolist()])[texf.faces]
    assert np.quantile(degrees(texf.shading_normals(), source), 0.99) < 0.3


def test_exact_normals_of_a_fine_hand_come_back_too():
    positions, faces, exact = hand(128)
    shading, _ = chosen(with_normals(positions, faces, exact))
    assert shading.evidence["degrees"][1] < 0.3 and shading.data is None


@pytest.mark.parametrize("angle, flat", [(25, True), (70, False)])
def test_a_rule_finds_the_angle_between_hard_and_soft(angle, flat):
    """A prism of 36 or 6 sides: its sides are soft at 10 degrees, the rims hard at 90; or all hard."""
    sides = 36 if angle == 25 else 6
    prism = trimesh.creation.cylinder(1, 2, sections=sides)
    lattice = np.rint(prism.vertices * 1000).astype(np.int64) + 3000
    normals = corner_normals(lattice, prism.faces, [NormalRule(JOINED, ANGLE, angle)])
    shading, surface = chosen(with_normals(prism.vertices, prism.faces, normals))
    assert shading.evidence["degrees"][2] < 0.2 and shading.marks is None
    assert 0 < shading.rules[0].angle < 90 or not flat


def creased(rings=8, patches=6):
    """A ball of patches that are smooth in themselves and hard where they meet, which no angle tells."""
    positions, faces = sphere(rings)
    towards = np.random.default_rng(0).normal(size=(patches, 3))
    patch = (positions[faces].mean(axis=1) @ towards.T).argmax(axis=1)
    fan, flat = {}, np.cross(*(positions[faces[:, k]] - positions[faces[:, 0]] for k in (1, 2)))
    for f, face in enumerate(faces.tolist()):
        for v in face:
            fan[v, patch[f]] = fan.get((v, patch[f]), 0) + flat[f]
    normals = np.array([[fan[v, patch[f]] for v in face] for f, face in enumerate(faces.tolist())])
    return with_normals(positions, faces, normals / np.linalg.norm(normals, axis=2, keepdims=True))


def test_creases_that_no_angle_tells_are_marked_and_come_back():
    scene = creased()
    made = encode_scene(scene, SMALL)
    told, texf = made.choices["normals"], decode(made.data)
    assert told["usual_rule_degrees"][1] > ENOUGH[1] > 0.2 > told["degrees"][2]
    assert texf.materials[0].normals.kind == MARKED and texf.sharp_edges.sum() == told["sharp_edges"] > 0
    assert told["marks_bytes"] < len(texf.sharp_edges) / 8
    plain = decode(encode_scene(with_normals(scene.positions, scene.faces, scene.positions), SMALL).data)
    assert plain.sharp_edges is None and plain.materials[0].normals.kind != MARKED  # and a smooth ball needs none


def any_normals(shape, seed=0):
    """Normals of any directions, float64 [*shape, 3]."""
    random = np.random.default_rng(seed).normal(size=(*shape, 3))
    return random / np.linalg.norm(random, axis=-1, keepdims=True)


def bent_ball(rings=12, bend=0.2):
    """A ball whose normals lean, more than any rule says."""
    positions, faces = sphere(rings)
    leaning = positions / np.linalg.norm(positions, axis=1, keepdims=True) + bend * any_normals([len(positions)])
    return with_normals(positions, faces, leaning / np.linalg.norm(leaning, axis=1, keepdims=True))


def test_normals_that_no_rule_makes_are_coded():
    """At a vertex, at a corner, opposite to the surface: what comes back is within the step."""
    positions, faces = sphere(12)
    for scene in (bent_ball(), with_normals(positions, faces, any_normals((len(faces), 3))),
                  with_normals(positions, faces, -positions)):
        encoded = encode_scene(scene, SMALL)
        evidence, texf = encoded.choices["normals"], decode(encoded.data)
        allowed = np.degrees(evidence["normal_step"] * 2.0**-13)  # twice the tangent of half the angle
        assert texf.materials[0].normals == IN_STREAM and len(texf.coded_normals) == evidence["coded_normals"]
        assert evidence["degrees"][2] < allowed
    scene = bent_ball()
    texf = decode(encode_scene(scene, SMALL).data)
    where = dict(zip(map(tuple, texf.cube.to_lattice(scene.positions[scene.faces].reshape(-1, 3)).tolist()),
                     scene.corner_normal.reshape(-1, 3), strict=True))
    source = np.array([where[tuple(place)] for place in texf.lattice_positions.tolist()])[texf.faces]
    assert degrees(texf.shading_normals(), source).max() < allowed


def test_residuals_take_no_more_than_a_tenth_of_a_budget():
    scene = bent_ball(rings=24)
    surface = make_surface(scene, EncodeOptions())
    free = choose_normals(scene, surface).value
    size = len(free.coded.data)
    assert choose_normals(scene, surface, budget=10 * size).value.coded_normals == free.coded_normals
    under = choose_normals(scene, surface, budget=10 * size - 10)
    assert under.value.coded is None and under.warnings


def test_normals_of_faces_without_a_common_edge_stay_a_warning():
    """No edge can be marked there, so nothing is coded."""
    positions, faces = sphere(12)
    apart = positions[faces].reshape(-1, 3) + np.repeat(np.arange(len(faces)) * 3.0, 3)[:, None]
    report = Report()
    chosen(with_normals(apart, np.arange(len(apart)).reshape(-1, 3), any_normals((len(faces), 3))), report)
    assert len(report.warnings) == 1 and report.warnings[0].startswith("the shading normals differ from the source's")


def test_what_says_nothing_of_normals_is_flat_in_gltf_and_usual_elsewhere():
    for flat, rule in ((True, FLAT), (False, USUAL)):
        scene = scene_of(*sphere())
        scene.flat = flat
        shading, _ = chosen(scene)
        assert shading.rules == [rule] and shading.data is None and shading.evidence == {"reason": "the source has no normals"}


def test_materials_without_light_have_no_rule_in_the_stream():
    positions, faces, _ = hand(12)
    smooth, sizes = trimesh.Trimesh(positions, faces, process=False).vertex_normals, {}
    for unlit in (False, True):
        scene = with_normals(positions, faces, smooth, materials=[Material("skin", unlit=unlit)])
        data = encode_scene(scene, SMALL).data
        sizes[unlit] = len(data)
        assert (inspect(data)["materials"][0]["normal_rule"] is None) == unlit
        assert decode(data).materials[0].normals == USUAL or not unlit
    assert sizes[False] == sizes[True] + 2


# Hard cases


def test_one_face_comes_back_with_any_normals():
    positions, faces = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]]), np.array([[0, 1, 2]])
    for normals in ([[0, 0, 1]] * 3, [[1, 0, 0], [0, 1, 0], [0, 0, -1]]):
        texf = decode(encode_scene(with_normals(positions, faces, np.array(normals)), SMALL).data)
        np.testing.assert_allclose(texf.shading_normals(), np.broadcast_to([0, 0, 1], (1, 3, 3)), atol=1e-6)


def test_faces_that_all_collapse_make_an_empty_stream():
    scene = with_normals(np.zeros((3, 3)), np.array([[0, 1, 2]]), np.array([[0, 0, 1]] * 3))
    texf = decode(encode_scene(scene, EncodeOptions(resolution=32, qp=40, allow_empty=True)).data)
    assert texf.shading_normals().shape == (0, 3, 3)


def test_three_hundred_faces_at_a_vertex():
    """A cone: at its tip every face would look at all others; a rule over edges needs no such look."""
    around = np.arange(300) * 2 * np.pi / 300
    positions = np.concatenate([np.stack([np.cos(around), np.sin(around), 0 * around], axis=1), [[0, 0, 0.3]]])
    faces = np.stack([np.arange(300), (np.arange(300) + 1) % 300, np.full(300, 300)], axis=1)
    lattice = np.rint(positions * 100_000).astype(np.int64) + 200_000
    tip = lambda *rule: corner_normals(lattice, faces, [NormalRule(*rule)])[:, 2]
    for rule in ((JOINED, AREA, 180), (JOINED, BOTH, 30), (JOINED, ANGLE, 180)):
        assert degrees(tip(*rule), [0, 0, 1]).max() < 0.1
    smooth = corner_normals(lattice, faces, [NormalRule(JOINED, ANGLE, 30)])
    shading, _ = chosen(with_normals(positions, faces, smooth))
    assert shading.evidence["degrees"][2] < 0.1


def test_sheets_that_lie_on_each_other_keep_their_sides():
    positions, faces, _ = hand(32)
    smooth = trimesh.Trimesh(positions, faces, process=False).vertex_normals
    inside = faces[:, ::-1]
    scene = with_normals(positions, np.concatenate([faces, inside]), np.concatenate([smooth[faces], -smooth[inside]]))
    shading, surface = chosen(scene)
    assert len(surface.faces) == 2 * len(faces)
    assert shading.evidence["degrees"][1] < 0.2 and shading.rules[0].angle not in (0, 180)


def test_a_hundred_and_sixty_seven_materials_have_a_rule_each():
    positions, faces, smooth = hand(24)
    material = np.arange(len(faces)) * 167 // len(faces)
    flat = corner_normals(np.rint(positions * 1000).astype(np.int64) + 9000, faces, [FLAT])
    hard = material % 2 == 0
    scene = with_normals(positions, faces, np.where(hard[:, None, None], flat, smooth[faces]),
                         materials=[Material(f"m{i}") for i in range(167)], face_material=material)
    made = encode_scene(scene, EncodeOptions(resolution=32, qp=40, partition="off", threads=1))
    texf = decode(made.data)
    assert len(texf.materials) == 167 and all(texf.materials[i].normals.angle == 0 for i in range(0, 167, 2))
    got = texf.shading_normals()
    own = corner_normals(texf.lattice_positions, texf.faces, [FLAT])
    assert degrees(got, own)[texf.face_material % 2 == 0].max() < 0.05
    assert np.median(degrees(got, own)[texf.face_material % 2 == 1]) > 1


# The stream


def test_isolated_decoding_gives_the_same_normals():
    data = encode_scene(creased(), SMALL).data
    ours, plain = decode(data, DecodeOptions(isolate=True)), decode(data)
    assert np.array_equal(ours.sharp_edges, plain.sharp_edges) and ours.materials[0].normals == plain.materials[0].normals
    assert np.array_equal(ours.shading_normals(), plain.shading_normals())


@pytest.mark.parametrize("make", [creased, bent_ball])
def test_gltf_is_written_with_these_normals_and_without_any_where_flat(tmp_path, make):
    scene = make()
    texf = decode(encode_scene(scene, SMALL).data)
    texf.save(tmp_path / "a.glb", appearance="texture", texture_size=64)
    back = load(tmp_path / "a.glb")
    order = np.lexsort(np.round(back.positions[back.faces].mean(axis=1), 5).T)
    other = np.lexsort(np.round(texf.positions[texf.faces].mean(axis=1), 5).T)
    a, b = back.corner_normal[order], texf.shading_normals()[other]
    near = np.abs(back.positions[back.faces][order][:, :, None] - texf.positions[texf.faces][other][:, None]).max(-1).argmin(2)
    assert degrees(a, np.take_along_axis(b, near[..., None], 1)).max() < 0.1
    scene.corner_normal = None  # of glTF: flat
    texf = decode(encode_scene(scene, SMALL).data)
    texf.save(tmp_path / "b.glb", appearance="texture", texture_size=64)
    assert texf.materials[0].normals == FLAT and load(tmp_path / "b.glb").corner_normal is None


def test_info_says_how_normals_are_made(tmp_path, call):
    (tmp_path / "a.texf").write_bytes(encode_scene(creased(), SMALL).data)
    code, out, _ = call("texf-info", tmp_path / "a.texf")
    assert code == 0 and "normals of 1 material: faces joined over edges that are not marked as sharp" in out
    assert "marks of sharp edges: " in out


# Figures


def test_quantiles_are_over_the_weight():
    assert quantiles(np.array([3.0, 1.0, 2.0]), np.array([1.0, 1.0, 2.0]), (0.25, 0.5, 0.75, 1.0)) == [1, 2, 2, 3]
    assert quantiles(np.zeros(0), np.zeros(0), (0.5,)) == [0]


@pytest.mark.parametrize("name, marked", [("cat_webp", False), ("ycb_scissors", False), ("vintage_fan", True),
                                          ("virtual_city", True), ("house_mask", True)])
def test_assets_come_back_within_half_a_degree_and_five(name, marked):
    path = REPOSITORY.parent / "shared" / "assets" / f"{name}.glb"
    if not path.is_file():
        pytest.skip("the real assets are not there")
    shading, _ = chosen(load(path))
    median, most, _ = shading.evidence["degrees"]
    assert median <= ENOUGH[0] and most <= ENOUGH[1] and (shading.data is not None) == marked
    assert shading.evidence["usual_rule_degrees"][1] > ENOUGH[1]


# Of the decoded geometry alone


def lattice_of(mesh, scale):
    return np.rint(mesh.vertices * scale).astype(np.int64) + 2 * scale, np.asarray(mesh.faces, np.int64)


def test_a_cube_keeps_its_edges():
    box = trimesh.creation.box()
    lattice, faces = lattice_of(box, 1000)
    expected = np.repeat(np.asarray(box.face_normals, np.float32)[:, None], 3, axis=1)
    assert np.abs(corner_normals(lattice, faces) - expected).max() < 1e-6


def test_a_ball_is_smooth_to_two_degrees_also_across_duplicated_vertices():
    ball = trimesh.creation.icosphere(subdivisions=4)
    lattice, faces = lattice_of(ball, 100_000)
    soup = np.arange(3 * len(faces)).reshape(-1, 3)
    got = corner_normals(lattice[faces].reshape(-1, 3), soup)
    cosine = np.einsum("fcd,fcd->fc", got, ball.vertices[ball.faces])
    assert cosine.min() > np.cos(np.radians(2))
    assert len(np.unique(got.reshape(-1, 3), axis=0)) <= 1.05 * len(ball.vertices)


def test_normals_have_length_one_whatever_the_faces():
    lattice = np.array([[0, 0, 0], [5, 0, 0], [10, 0, 0], [0, 7, 3]])
    faces = np.array([[0, 1, 2], [0, 1, 3], [3, 1, 0]])
    assert np.abs(np.linalg.norm(corner_normals(lattice, faces), axis=2) - 1).max() < 1e-6
    assert corner_normals(lattice, np.zeros((0, 3), np.int64)).shape == (0, 3, 3)


def test_edges_that_nothing_shares_have_no_fold():
    faces = np.array([[0, 1, 2]])
    assert len(folds(shared_edges(faces), np.array([[0, 0, 0], [9, 0, 0], [0, 9, 0]]), faces)) == 0


def test_a_joined_rule_goes_round_a_prism():
    prism = trimesh.creation.cylinder(1, 2, sections=6)
    lattice = np.rint(prism.vertices * 1000).astype(np.int64) + 3000
    hard, soft = (corner_normals(lattice, prism.faces, [NormalRule(JOINED, ANGLE, angle)]) for angle in (20, 80))
    turned = np.degrees(np.arccos(np.clip((hard * soft).sum(-1), -1, 1))).ravel()
    assert np.isclose(hard[..., None, :] @ soft[..., None], 1, atol=1e-5).any() and 25 < turned.max() < 35


@pytest.mark.parametrize("shown", [0.0, 1e-30, 1e30])
def test_the_step_of_coded_normals_stays_within_its_bounds_whatever_normals_show(shown):
    """Black materials show nothing of their normals, mirrors a highlight in one pixel."""
    scene = bent_ball(rings=24)
    scene.weights = {SHADING: shown}
    coded = choose_normals(scene, make_surface(scene, EncodeOptions()), attributes=5000.0).value.coded
    assert coded.step == (LEAST_STEP if shown == 1e30 else STEP)
