import numpy as np
import oracle
import pytest
from hypothesis import given, strategies as st
from scipy import sparse
from sklearn.base import clone
from sklearn.utils.estimator_checks import parametrize_with_checks

from slam_bof.bof import TfIdf, Vocabulary, count_words


@parametrize_with_checks([Vocabulary(n_words=2), TfIdf()])
def test_estimators_keep_scikit_learns_rules(estimator, check):
    check(estimator)


@pytest.fixture(scope="module")
def descriptors():
    rng = np.random.default_rng(0)
    return rng.random((400, 12), dtype=np.float32)


def test_words_are_centres_of_their_descriptors():
    corners = np.eye(6, dtype=np.float32)
    rng = np.random.default_rng(1)
    near = np.repeat(corners, 50, axis=0) + rng.normal(0, 0.02, (300, 6)).astype(np.float32)
    vocabulary = Vocabulary(n_words=6).fit(near)
    distances = np.linalg.norm(vocabulary.words_[:, None] - corners, axis=2)
    assert distances.min(axis=0).max() < 0.05
    assert len(set(vocabulary.predict(corners).tolist())) == 6
    np.testing.assert_array_equal(vocabulary.labels_, vocabulary.predict(near))


def test_the_word_is_the_nearest(descriptors):
    vocabulary = Vocabulary(n_words=40).fit(descriptors)
    distances = np.linalg.norm(descriptors[:, None] - vocabulary.words_, axis=2)
    words = vocabulary.predict(descriptors)
    assert words.dtype == np.int32
    np.testing.assert_array_equal(words, distances.argmin(axis=1))
    np.testing.assert_array_equal(words, vocabulary.lookup(descriptors))
    assert vocabulary.lookup(descriptors[:0]).shape == (0,)


def test_the_same_seed_gives_the_same_bytes(descriptors):
    first = Vocabulary(n_words=30, seed=5).fit(descriptors)
    again = clone(first).fit(descriptors)
    other = Vocabulary(n_words=30, seed=6).fit(descriptors)
    assert first.words_.tobytes() == again.words_.tobytes()
    assert first.words_.tobytes() != other.words_.tobytes()


def test_given_words_make_a_fitted_vocabulary(descriptors):
    fitted = Vocabulary(n_words=30, seed=5).fit(descriptors)
    given_words = Vocabulary.from_words(fitted.words_, seed=5)
    np.testing.assert_array_equal(given_words.predict(descriptors), fitted.predict(descriptors))
    assert given_words.get_params() == fitted.get_params()


def test_too_few_descriptors_are_refused(descriptors):
    with pytest.raises(ValueError, match="got 401 words for n_samples = 400"):
        Vocabulary(n_words=401).fit(descriptors)


def test_words_that_nobody_needs_are_among_the_descriptors():
    distinct = 1 + np.random.default_rng(2).random((10, 12), dtype=np.float32)
    vocabulary = Vocabulary(n_words=40).fit(np.repeat(distinct, 10, axis=0))
    apart = np.linalg.norm(vocabulary.words_[:, None] - distinct, axis=2)
    assert apart.min(axis=1).max() < 1e-5
    assert apart.min(axis=0).max() < 1e-5


@pytest.mark.parametrize("shape", [(50, 12), (1, 5)])
def test_equal_descriptors_become_the_words(shape):
    words = Vocabulary(n_words=min(8, shape[0])).fit(np.full(shape, 0.7)).words_
    np.testing.assert_allclose(words, 0.7, rtol=1e-6)


@given(st.integers(1, 40), st.integers(1, 40), st.integers(1, 20), st.integers(0, 3))
def test_any_shape_gives_words_no_worse_than_one(n_words, n_more, n_values, n_decimals):
    rng = np.random.default_rng(n_words + 41 * n_values)
    X = rng.random((n_words + n_more, n_values)).round(n_decimals).astype(np.float32)
    vocabulary = Vocabulary(n_words=n_words).fit(X)
    assert vocabulary.words_.shape == (n_words, n_values)
    np.testing.assert_array_equal(vocabulary.labels_, vocabulary.predict(X))
    inertia = ((X - vocabulary.words_[vocabulary.labels_]) ** 2).sum()
    assert inertia <= ((X - X.mean(axis=0)) ** 2).sum() * (1 + 1e-5) + 1e-6


def test_idf_is_the_papers():
    counts = count_words([np.array(words) for words in ([0, 0, 1], [0, 2], [0])], n_words=4)
    expected = np.log([3 / 3, 3 / 1, 3 / 1, 3 / 1])  # word 3 counts as found in one frame
    np.testing.assert_allclose(TfIdf().fit(counts).idf_, expected, rtol=1e-6)
    np.testing.assert_allclose(TfIdf().fit(counts.toarray()).idf_, expected, rtol=1e-6)


@given(
    st.lists(st.lists(st.integers(0, 7), max_size=12), min_size=1, max_size=6),
    st.lists(st.integers(0, 7), max_size=12),
)
def test_bags_equal_the_oracle(frames, words):
    tf_idf = TfIdf().fit(count_words([np.array(f, np.int32) for f in frames], n_words=8))
    bag = tf_idf.bag(np.array(words, np.int32))
    # One-dimensional "descriptors" that are their own words.
    centres = np.arange(8.0)[:, None]
    expected = oracle.bag(np.array(words, float).reshape(-1, 1), centres, tf_idf.idf_)
    dense = np.zeros(8)
    dense[bag.words] = bag.weights
    np.testing.assert_allclose(dense, expected, atol=1e-6)
    assert (bag.weights > 0).all()
    assert (np.diff(bag.words) > 0).all()
    assert bag.words.dtype == np.int32
    assert bag.weights.dtype == np.float32
    one_row = tf_idf.transform(count_words([np.array(words, np.int32)], n_words=8))
    np.testing.assert_allclose(one_row.toarray()[0], expected, atol=1e-6)


def test_transform_keeps_sparse_rows_that_sum_to_one():
    counts = sparse.csr_array(np.array([[2.0, 1, 0], [0, 0, 0], [0, 1, 3]]))
    bags = TfIdf().fit(counts).transform(counts)
    assert bags.dtype == np.float32
    np.testing.assert_allclose(bags.sum(axis=1), [1, 0, 1], rtol=1e-6)
