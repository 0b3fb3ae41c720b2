import numpy as np
import oracle
import pytest
from hypothesis import given, strategies as st

from slam_bof.bof import InvertedIndex
from slam_bof.types import Bag

N_WORDS = 12


def bag_of(weights_by_word):
    words = np.array(sorted(weights_by_word), np.int32)
    weights = np.array([weights_by_word[word] for word in words.tolist()], np.float64)
    return Bag(words, (weights / weights.sum()).astype(np.float32))


def dense(bag, n_words=N_WORDS):
    vector = np.zeros(n_words)
    vector[bag.words] = bag.weights
    return vector


bags = st.dictionaries(
    st.integers(0, N_WORDS - 1), st.floats(0.01, 1.0), min_size=1, max_size=N_WORDS
).map(bag_of)


@given(st.lists(bags, max_size=20), bags)
def test_scores_equal_brute_force(held, query):
    index = InvertedIndex(N_WORDS)
    assert [index.add(bag) for bag in held] == list(range(len(held)))
    expected = [oracle.score(dense(bag), dense(query)) for bag in held]
    scores = index.scores(query)
    assert scores.dtype == np.float32
    assert len(index) == len(scores) == len(held)
    np.testing.assert_allclose(scores, expected, atol=1e-6)


@given(st.lists(bags, min_size=1, max_size=20), bags)
def test_scores_do_not_depend_on_when_bags_came(held, query):
    one_by_one, afterwards = InvertedIndex(N_WORDS), InvertedIndex(N_WORDS)
    for bag in held:
        before = one_by_one.scores(query)
        one_by_one.add(bag)
        np.testing.assert_array_equal(one_by_one.scores(query)[:-1], before)
        afterwards.add(bag)
    np.testing.assert_array_equal(one_by_one.scores(query), afterwards.scores(query))
    assert one_by_one.nbytes == afterwards.nbytes >= 8 * sum(len(bag.words) for bag in held)


@given(bags, bags)
def test_the_score_is_symmetric_and_one_for_itself(a, b):
    index = InvertedIndex(N_WORDS)
    index.add(a)
    index.add(b)
    assert index.scores(a)[0] == pytest.approx(1.0, abs=1e-6)
    assert index.scores(a)[1] == pytest.approx(index.scores(b)[0], abs=1e-6)
    assert (index.scores(a) <= 1.0).all()


def test_many_bags_equal_brute_force():
    rng = np.random.default_rng(0)
    counts = rng.poisson(0.03, (500, 300)) * rng.random((500, 300))
    counts[:, 0] += 0.1
    matrix = counts / counts.sum(axis=1, keepdims=True)
    index = InvertedIndex(300)
    for row in matrix:
        words = np.flatnonzero(row).astype(np.int32)
        index.add(Bag(words, row[words].astype(np.float32)))
    words = np.flatnonzero(matrix[7]).astype(np.int32)
    scores = index.scores(Bag(words, matrix[7, words].astype(np.float32)))
    np.testing.assert_allclose(scores, 1 - 0.5 * np.abs(matrix - matrix[7]).sum(axis=1), atol=1e-5)


def test_an_empty_bag_scores_nothing():
    nothing = Bag(np.empty(0, np.int32), np.empty(0, np.float32))
    index = InvertedIndex(N_WORDS)
    assert index.scores(nothing).shape == (0,)
    index.add(nothing)
    index.add(bag_of({3: 1.0}))
    assert index.scores(nothing).tolist() == [0.0, 0.0]
    assert index.scores(bag_of({3: 1.0})).tolist() == [0.0, 1.0]


def test_a_word_outside_the_vocabulary_is_refused():
    with pytest.raises(ValueError, match=r"words must be in 0 \.\. 11, got 3 \.\. 12"):
        InvertedIndex(N_WORDS).add(bag_of({3: 0.5, 12: 0.5}))


def test_memory_is_little_more_than_the_postings():
    rng = np.random.default_rng(0)
    index = InvertedIndex(50)
    for _ in range(2000):
        words = np.sort(rng.choice(50, 10, replace=False)).astype(np.int32)
        index.add(Bag(words, np.full(10, 0.1, np.float32)))
    postings_bytes = 2000 * 10 * 8
    assert postings_bytes <= index.nbytes <= 1.15 * postings_bytes
