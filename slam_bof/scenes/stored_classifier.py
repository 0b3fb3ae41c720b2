"""A scene classifier of bags in a model file: written by skops, and checked before it is used.

The file may come from anybody. skops creates objects of trusted types only, but scikit-learn's
compiled code believes the arrays in them: a tree whose child lies outside of it is read beyond its
memory. So the schema is compared with what the six classifiers consist of, and every number that
compiled code uses as an index or a size is checked; a first prediction then shows the rest.
"""

from __future__ import annotations

import io
import json
import math
import warnings
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from sklearn.ensemble import RandomForestClassifier
from sklearn.exceptions import InconsistentVersionWarning
from sklearn.neighbors import KNeighborsClassifier
from sklearn.svm import SVC

from slam_bof.core import parse_npy
from slam_bof.scenes.bag_classifier import SceneClassifier
from slam_bof.types import Bag

__all__ = ["Entries", "classifier_bytes", "load_classifier", "read_entries", "zip_entries"]

NODES = {
    "DictNode": {"builtins.dict"},
    "ListNode": {"builtins.list"},
    "TupleNode": {"builtins.tuple"},
    "JsonNode": {"builtins.str"},
    "TypeNode": {"builtins.str"},
    "NdArrayNode": {"numpy.float64", "numpy.int64", "numpy.ndarray"},
    "RandomStateNode": {"numpy.random.mtrand.RandomState"},
    "SparseMatrixNode": {"scipy.sparse._csr.csr_array", "scipy.sparse._csr.csr_matrix"},
    "TreeNode": {"sklearn.tree._tree.Tree"},
    "ObjectNode": {
        "sklearn.calibration.CalibratedClassifierCV",
        "sklearn.calibration._CalibratedClassifier",
        "sklearn.calibration._SigmoidCalibration",
        "sklearn.ensemble._forest.RandomForestClassifier",
        "sklearn.naive_bayes.MultinomialNB",
        "sklearn.neighbors._classification.KNeighborsClassifier",
        "sklearn.neural_network._multilayer_perceptron.MLPClassifier",
        "sklearn.neural_network._stochastic_optimizers.AdamOptimizer",
        "sklearn.preprocessing._label.LabelBinarizer",
        "sklearn.svm._classes.LinearSVC",
        "sklearn.svm._classes.SVC",
        "sklearn.tree._classes.DecisionTreeClassifier",
        "slam_bof.scenes.SceneClassifier",
    },
}
"""The nodes of a skops schema that a scene classifier has, and their types."""
MAX_BYTES = 1 << 28
"""Largest unpacked size of a model; those that come with slam_bof have 2 MB."""

Entries = dict[str, bytes]
"""The files in a zip, by name."""


def read_entries(data: bytes) -> Entries:
    """Return the files in a zip; ``zipfile.BadZipFile`` if they are too large or not all there."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        n_bytes = sum(entry.file_size for entry in archive.infolist())
        if n_bytes > MAX_BYTES:
            raise zipfile.BadZipFile(f"found {n_bytes} bytes inside, expected {MAX_BYTES} at most")
        return {name: archive.read(name) for name in archive.namelist()}


def zip_entries(entries: Entries, compression: int) -> bytes:
    """Return a zip of files, the same bytes every time."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", compression) as archive:
        for name, data in entries.items():
            # A ZipInfo made by hand has a constant time stamp.
            archive.writestr(zipfile.ZipInfo(name), data, compression)
    return buffer.getvalue()


def classifier_bytes(classifier: SceneClassifier) -> bytes:
    """Serialise a scene classifier for a model file, by skops, to the same bytes every time."""
    import skops.io

    # skops names objects and files by memory address; number them in order of appearance instead.
    with zipfile.ZipFile(io.BytesIO(skops.io.dumps(classifier))) as archive:
        schema = json.loads(archive.read("schema.json"))
        renamed = _number_ids(schema)
        files = {new: archive.read(old) for old, new in renamed.items()}
    return zip_entries({**files, "schema.json": json.dumps(schema).encode()}, zipfile.ZIP_STORED)


def _number_ids(schema: Any) -> dict[str, str]:
    """Renumber the ids and files of a skops schema in place; return the files' new names."""
    ids: dict[int, int] = {}
    files: dict[str, str] = {}
    for node in _dicts(schema):
        if isinstance(node.get("__id__"), int):
            node["__id__"] = ids.setdefault(node["__id__"], len(ids) + 1)
        if isinstance(node.get("file"), str):
            suffix = Path(node["file"]).suffix
            node["file"] = files.setdefault(node["file"], f"{len(files)}{suffix}")
    return files


def _dicts(schema: Any) -> Iterator[dict[str, Any]]:
    """Yield the dictionaries in a JSON value, outer before inner."""
    if isinstance(schema, dict):
        yield schema
    for child in schema.values() if isinstance(schema, dict) else schema:
        if isinstance(child, dict | list):
            yield from _dicts(child)


def load_classifier(data: bytes, n_words: int) -> SceneClassifier:
    """Restore a scene classifier from ``classifier_bytes``.

    Parameters
    ----------
    data
        The bytes.
    n_words
        Number of words in the bags that it will be given.

    Raises
    ------
    ValueError
        If it is none, or not one of such bags.
    """
    import skops.io

    try:
        entries = read_entries(data)
        _check_schema(json.loads(entries["schema.json"]), entries)
        with warnings.catch_warnings():
            # Other versions of scikit-learn read these plain attributes as well.
            warnings.simplefilter("ignore", InconsistentVersionWarning)
            trusted = sorted(set().union(*NODES.values()))
            classifier = skops.io.loads(data, trusted=trusted)
        if not isinstance(classifier, SceneClassifier):
            raise ValueError(f"found a {type(classifier).__name__}, expected a SceneClassifier")
        _check_classifier(classifier, n_words)
    except Exception as error:  # skops and scikit-learn raise anything for what is not theirs
        reason = " ".join(str(error).split())[:200]
        raise ValueError(f"scenes.skops: {type(error).__name__}: {reason}") from error
    return classifier


def _check_schema(schema: Any, entries: Entries) -> None:
    """Check that a skops schema has known nodes only, with whole files and sound trees."""
    arrays = {name: parse_npy(file) for name, file in entries.items() if name.endswith(".npy")}
    for name in entries:
        if name.endswith(".npz"):
            for inner in read_entries(entries[name]).values():
                parse_npy(inner)
    by_id: dict[Any, Any] = {}
    for node in _dicts(schema):
        if "__loader__" not in node:
            continue
        # skops takes the first node of an id for all. Objects that occur twice have states of
        # other ids, but only what trees are made of must be what is checked here.
        is_same = by_id.setdefault(node["__id__"], node) == node
        if not is_same and node["__loader__"] != "ObjectNode":
            raise ValueError(f"found two values of id {node['__id__']}, expected one")
        found = f"{node['__module__']}.{node['__class__']}"
        if found not in NODES.get(node["__loader__"], ()):
            raise ValueError(f"found a {found[:80]}, expected the parts of a scene classifier")
        if node["__loader__"] == "NdArrayNode" and node.get("type") != "numpy":
            raise ValueError("found an array of objects, expected numbers or text")
        if node["__loader__"] == "TreeNode":
            _check_tree(node, arrays)


def _check_tree(node: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
    """Check a decision tree: scikit-learn's compiled code believes its sizes and indices."""
    state = node["content"]["content"]
    n_features, n_classes, n_outputs = node["__reduce__"]["args"]["content"]
    nodes, values = (arrays[state[name]["file"]] for name in ("nodes", "values"))
    n_nodes = len(nodes)
    _expect(json.loads(n_outputs["content"]) == 1, "n_outputs")
    _expect(json.loads(state["node_count"]["content"]) == n_nodes > 0, "node_count")
    counts = arrays[n_classes["file"]]
    _expect(counts.shape == (1,) and values.shape == (n_nodes, 1, counts[0]), "values")
    left, right = nodes["left_child"], nodes["right_child"]
    is_leaf = left == -1
    # Children follow their parents, so that no path is endless.
    for child in (left, right):
        is_inside = (child > np.arange(n_nodes)) & (child < n_nodes)
        _expect(np.where(is_leaf, child == -1, is_inside).all(), "children")
    features = nodes["feature"][~is_leaf]
    _expect(((features >= 0) & (features < json.loads(n_features["content"]))).all(), "features")
    _expect(np.isfinite(nodes["threshold"]).all() and np.isfinite(values).all(), "values")


def _check_classifier(classifier: SceneClassifier, n_words: int) -> None:
    """Check what is used of a classifier, then let it label two bags."""
    classes, n_classes = classifier.classes_, len(classifier.classes_)
    _expect(classes.ndim == 1 and classes.dtype.kind == "U" and n_classes > 1, "classes_")
    _expect(len(set(classes.tolist())) == n_classes, "classes_")
    (calibrated,) = classifier.classifier_.calibrated_classifiers_
    estimator = calibrated.estimator
    for owner in (classifier, classifier.classifier_, estimator):
        _expect(owner.n_features_in_ == n_words, "n_features_in_")
    for owner in (classifier.classifier_, estimator, calibrated):
        own = owner.classes if owner is calibrated else owner.classes_
        _expect(
            np.array_equal(own, np.arange(n_classes)) or np.array_equal(own, classes), "classes"
        )
    n_margins = 1 if n_classes == 2 else n_classes
    _expect(len(calibrated.calibrators) == n_margins, "calibrators")
    for sigmoid in calibrated.calibrators:
        _expect(math.isfinite(sigmoid.a_) and math.isfinite(sigmoid.b_), "calibrators")
    for name, value in vars(estimator).items():
        if sparse.issparse(value):
            value.check_format(full_check=True)
            value = value.data
        if isinstance(value, np.ndarray) and value.dtype.kind == "f":
            _expect(np.isfinite(value).all(), name)
    if hasattr(estimator, "coef_") and not isinstance(estimator, SVC):
        _expect(estimator.coef_.shape == (n_margins, n_words), "coef_")
        _expect(estimator.intercept_.shape == (n_margins,), "intercept_")
    if isinstance(estimator, SVC):
        _check_svm(estimator, n_classes, n_words)
    if isinstance(estimator, KNeighborsClassifier):
        _check_neighbours(estimator, n_classes, n_words)
    if isinstance(estimator, RandomForestClassifier):
        for tree in (each.tree_ for each in estimator.estimators_):
            _expect(tree.n_features == n_words and tree.n_classes[0] == n_classes, "tree_")
    for words in (np.empty(0, np.int32), np.arange(n_words, dtype=np.int32)):
        weights = np.full(len(words), 1 / max(len(words), 1), np.float32)
        probabilities = classifier.predict_bag(Bag(words, weights)).probabilities
        _expect(probabilities.shape == (n_classes,), "probabilities")
        _expect(np.isfinite(probabilities).all() and probabilities.min() >= 0, "probabilities")
        _expect(abs(probabilities.sum() - 1.0) < 1e-6, "probabilities")


def _check_svm(svm: SVC, n_classes: int, n_words: int) -> None:
    vectors, coefficients = svm.support_vectors_, svm._dual_coef_
    n_vectors, n_pairs = vectors.shape[0], n_classes * (n_classes - 1) // 2
    _expect(svm.kernel == "rbf" and 0 < svm._gamma < math.inf, "kernel")
    _expect(vectors.shape == (n_vectors, n_words), "support_vectors_")
    _expect(svm.shape_fit_[1] == n_words, "shape_fit_")
    _expect(svm.support_.shape == (n_vectors,), "support_")
    _expect(svm._n_support.shape == (n_classes,) and svm._n_support.min() >= 0, "_n_support")
    _expect(svm._n_support.sum() == n_vectors, "_n_support")
    _expect(coefficients.shape == (n_classes - 1, n_vectors), "_dual_coef_")
    _expect(svm._intercept_.shape == (n_pairs,), "_intercept_")
    _expect(svm._probA.shape == svm._probB.shape == (0,), "_probA")
    _expect(svm.class_weight_.shape == (n_classes,), "class_weight_")
    _expect(svm._sparse == sparse.issparse(vectors) == sparse.issparse(coefficients), "_sparse")
    if svm._sparse:  # the compiled code takes the stored values for the whole matrix
        _expect(coefficients.nnz == (n_classes - 1) * n_vectors, "_dual_coef_")


def _check_neighbours(neighbours: KNeighborsClassifier, n_classes: int, n_words: int) -> None:
    n_samples = neighbours._fit_X.shape[0]
    _expect(neighbours._fit_X.shape == (n_samples, n_words), "_fit_X")
    _expect(n_samples == neighbours.n_samples_fit_ >= neighbours.n_neighbors > 0, "_fit_X")
    _expect(neighbours._y.shape == (n_samples,), "_y")
    _expect(((neighbours._y >= 0) & (neighbours._y < n_classes)).all(), "_y")
    _expect(neighbours.effective_metric_ == "euclidean", "effective_metric_")


def _expect(condition: bool | np.bool_, name: str) -> None:
    if not condition:
        raise ValueError(f"found an implausible {name}")
