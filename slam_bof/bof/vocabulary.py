"""Descriptors to visual words to bags: k-means codebook and TF-IDF (paper, section 3.3)."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from sklearn.base import BaseEstimator, ClusterMixin, TransformerMixin
from sklearn.cluster import KMeans, kmeans_plusplus
from sklearn.decomposition import PCA
from sklearn.exceptions import ConvergenceWarning
from sklearn.utils import Tags
from sklearn.utils.validation import check_is_fitted, check_non_negative, validate_data

from slam_bof.core import one_native_thread
from slam_bof.types import Array, Bag

__all__ = ["TfIdf", "Vocabulary", "count_words"]


@dataclass(eq=False, repr=False)
class Vocabulary(ClusterMixin, BaseEstimator):
    """A codebook of visual words by k-means (paper, section 3.3), at a fraction of its cost.

    The radii of closed curves vary smoothly, so a few principal components preserve almost all
    distances. Lloyd's iterations run on these components, first on a sample, then a few on all
    descriptors; the words are the means of the descriptors in full length.

    Parameters
    ----------
    n_words
        Number of words (k).
    seed
        Seed of the initial words (k-means++) and the sample; the same descriptors and seed give
        the same words.
    n_components
        Number of principal components that clusters are found in, or all if there are fewer.
    sample_per_word, sample_iterations
        Size of the sample, in descriptors a word, and largest number of iterations on it.
    iterations
        Largest number of iterations on all descriptors.

    Attributes
    ----------
    words_ : (n_words, D) float32
        The words.
    labels_ : (M,) int32
        The word of each descriptor passed to ``fit``.
    """

    n_words: int = 1024
    seed: int = 0
    n_components: int = 16
    sample_per_word: int = 30
    sample_iterations: int = 20
    iterations: int = 8

    def fit(self, X: NDArray[Any], y: object = None) -> Self:
        """Learn the words of descriptors (M, D).

        Raises
        ------
        ValueError
            If there are fewer descriptors than words.
        """
        X = validate_data(self, X, dtype=np.float32, order="C")
        if len(X) < self.n_words:
            raise ValueError(
                f"n_words must be at most the number of descriptors, got {self.n_words} words "
                f"for n_samples = {len(X)}"
            )
        # With one thread sums have one order, and the same seed gives the same bytes.
        with one_native_thread(), warnings.catch_warnings():
            # Descriptors may have fewer distinct values than there are words.
            warnings.simplefilter("ignore", ConvergenceWarning)
            self._set_words(self._learn(X))
        self.labels_ = self._nearest(X)
        return self

    def _learn(self, X: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the words (n_words, D), by clusters in the principal components."""
        if len(X) == 1:  # no components
            return X
        components = PCA(min(self.n_components, *X.shape), svd_solver="covariance_eigh")
        with np.errstate(invalid="ignore"):  # ratios to a variance of zero, which are not used
            reduced = np.ascontiguousarray(components.fit_transform(X), np.float32)
        random = np.random.default_rng(self.seed)
        n_sampled = min(self.sample_per_word * self.n_words, len(X))
        sample = reduced[random.permutation(len(X))[:n_sampled]]
        centres, _ = kmeans_plusplus(sample, self.n_words, random_state=self.seed, n_local_trials=1)
        for points, n_iterations in (
            (sample, self.sample_iterations),
            (reduced, self.iterations),
        ):
            kmeans = KMeans(self.n_words, init=centres, n_init=1, max_iter=n_iterations)
            centres = kmeans.fit(points).cluster_centers_
        means, counts = _means(X, kmeans.labels_, self.n_words)
        # Empty clusters keep the centre that k-means gave them.
        return np.where(counts[:, None] > 0, means, components.inverse_transform(centres))

    def predict(self, X: NDArray[Any]) -> NDArray[np.int32]:
        """Return the nearest word of each descriptor: (M, D) to (M,) int32."""
        check_is_fitted(self, "words_")
        X = validate_data(self, X, dtype=np.float32, order="C", reset=False)
        return self._nearest(X)

    def lookup(self, descriptors: NDArray[np.float32]) -> NDArray[np.int32]:
        """Return what ``predict`` returns, without its checks; (0, D) gives no words."""
        return self._nearest(descriptors)

    @classmethod
    def from_words(cls, words: NDArray[np.float32], **params: Any) -> Self:
        """Return a fitted vocabulary that has the given words (n_words, D)."""
        vocabulary = cls(n_words=len(words), **params)
        vocabulary._set_words(words)
        vocabulary.n_features_in_ = words.shape[1]
        return vocabulary

    def _set_words(self, words: NDArray[Any]) -> None:
        self.words_ = np.ascontiguousarray(words, np.float32)
        self._half_square_norms = 0.5 * np.einsum("wd,wd->w", self.words_, self.words_)

    def _nearest(self, X: NDArray[np.float32], block: int = 4096) -> NDArray[np.int32]:
        # argmin |x - w|^2 = argmax (x . w - |w|^2 / 2): one matrix product.
        nearest = np.empty(len(X), np.int32)
        for start in range(0, len(X), block):
            closeness = X[start : start + block] @ self.words_.T
            closeness -= self._half_square_norms
            nearest[start : start + block] = closeness.argmax(axis=1)
        return nearest


def _means(
    X: NDArray[np.float32], clusters: NDArray[np.int32], n_clusters: int
) -> tuple[NDArray[np.float32], NDArray[np.intp]]:
    """Return the mean (n_clusters, D) and the size (n_clusters,) of each cluster."""
    members = sparse.csr_array(
        (np.ones(len(X), np.float32), clusters, np.arange(len(X) + 1)), (len(X), n_clusters)
    )
    counts = np.bincount(clusters, minlength=n_clusters)
    return (members.T @ X) / np.maximum(counts, 1)[:, None], counts


@dataclass(eq=False, repr=False)
class TfIdf(TransformerMixin, BaseEstimator):
    """Weigh word counts by how rare the word is, and normalise them to sum 1 (paper, eq. 4).

    Of N training frames, ``N_i`` hold word i: ``idf_i = ln(N / N_i)``. A word that no
    training frame holds counts as held by one. In a frame of n words, word i, found n_i
    times, weighs ``n_i / n * idf_i`` (the n is gone after normalising).

    Attributes
    ----------
    idf_ : (n_words,) float32
        The inverse document frequencies.
    """

    def fit(self, X: Any, y: object = None) -> Self:
        """Learn the idf of word counts (n_frames, n_words), dense or sparse."""
        X = validate_data(self, X, accept_sparse="csr", dtype=np.float64)
        check_non_negative(X, "TfIdf (word counts)")
        if sparse.issparse(X):
            n_holding = np.bincount(X.indices[X.data > 0], minlength=X.shape[1])
        else:
            n_holding = np.count_nonzero(X > 0, axis=0)
        self.idf_ = np.log(X.shape[0] / np.maximum(n_holding, 1)).astype(np.float32)
        return self

    def transform(self, X: Any) -> Any:
        """Return the bags, csr (n_frames, n_words) float32, of word counts of that shape."""
        check_is_fitted(self, "idf_")
        X = validate_data(self, X, accept_sparse="csr", dtype=np.float64, reset=False)
        weights = sparse.csr_array(sparse.csr_array(X).multiply(self.idf_))
        weights.eliminate_zeros()
        sums = weights.sum(axis=1)
        sums[sums == 0.0] = 1.0
        weights.data /= np.repeat(sums, np.diff(weights.indptr))
        return weights.astype(np.float32)

    def bag(self, words: NDArray[np.int32]) -> Bag:
        """Return the bag of one frame's words (n,)."""
        distinct, counts = np.unique(words, return_counts=True)
        weights = counts * self.idf_[distinct]
        known = weights > 0
        weights = weights[known]
        return Bag(
            words=distinct[known].astype(np.int32),
            weights=(weights / weights.sum()).astype(np.float32),
        )

    def __sklearn_tags__(self) -> Tags:
        tags: Tags = super().__sklearn_tags__()
        tags.input_tags.sparse = True
        tags.input_tags.positive_only = True
        tags.transformer_tags.preserves_dtype = ["float32"]
        return tags

    @classmethod
    def from_idf(cls, idf: Array) -> Self:
        """Return a fitted TF-IDF that has the given idf (n_words,)."""
        tf_idf = cls()
        tf_idf.idf_ = np.asarray(idf, np.float32)
        tf_idf.n_features_in_ = len(idf)
        return tf_idf


def count_words(frames: Iterable[NDArray[np.int32]], n_words: int) -> Any:
    """Return the word counts of frames, csr (n_frames, n_words) float32.

    >>> count_words([np.array([2, 0, 2]), np.array([], np.int32)], n_words=3).toarray().tolist()
    [[1.0, 0.0, 2.0], [0.0, 0.0, 0.0]]
    """
    counted = [np.unique(words, return_counts=True) for words in frames]
    # scikit-learn's solvers take 32-bit indices only.
    indptr = np.cumsum([0, *(len(words) for words, _ in counted)], dtype=np.int32)
    indices = np.concatenate([np.empty(0, np.int32), *(words for words, _ in counted)])
    data = np.concatenate([np.empty(0, np.float32), *(counts for _, counts in counted)])
    shape = (len(counted), n_words)
    return sparse.csr_array((data.astype(np.float32), indices.astype(np.int32), indptr), shape)
