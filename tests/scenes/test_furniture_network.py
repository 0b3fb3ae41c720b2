import numpy as np
import pytest
from levelled_scene import empty_frame, table_frame

from slam_bof.scenes import (
    FurnitureNetwork,
    FurnitureTraining,
    LevelledClassifier,
    fit_furniture,
    furniture_view,
    levelled_features,
)
from slam_bof.scenes.furniture_network import IMAGE_SHAPE, KERNELS, WIDTHS, furniture_image
from slam_bof.scenes.levelled_cloud import levelled_cloud
from slam_bof.scenes.mlp_ensemble import MlpEnsemble

N_PIECES, N_ROOMS = 3, 2


@pytest.fixture(scope="module")
def network():
    """Return a network of random weights."""
    rng = np.random.default_rng(0)
    arrays, n = {}, IMAGE_SHAPE[0]
    for k, (width, size) in enumerate(zip(WIDTHS, KERNELS, strict=True)):
        arrays[f"kernel_{k}"] = rng.normal(0.0, (2 / (n * size**2)) ** 0.5, (width, n, size, size))
        arrays[f"bias_{k}"], n = rng.normal(0.0, 0.1, width), width
    for name, outputs, inputs in (("piece", N_PIECES, n), ("room", N_ROOMS, 2 * n)):
        arrays[name] = rng.normal(0.0, 0.2, (outputs, inputs))
        arrays[f"{name}_bias"] = np.zeros(outputs)
    return FurnitureNetwork.from_arrays(arrays)


def tables(seed, n):
    rng = np.random.default_rng(seed)
    for i in range(n):
        yield (
            table_frame(table_m=(0.45, 0.9)[i % 2], ahead_m=rng.uniform(1.8, 2.3), eye_m=1.5),
            ("bench", "counter")[i % 2],
        )


def test_the_image_holds_what_is_known_of_each_pixel():
    cloud = levelled_cloud(table_frame(table_m=0.9, eye_m=1.5))
    image = furniture_image(cloud)
    rows, columns = cloud.grid_points.shape[:2]
    assert image.shape == IMAGE_SHAPE
    assert not image[:, rows:].any()
    height_m, up, _, _, known, floor = image[:, :rows, :columns]
    table = (up > 0.95) & (np.abs(height_m + 1.0 - 0.9) < 0.05) & (known > 0)
    assert table.sum() > 50
    assert (floor[table] < 1e-6).all()
    on_floor = (up > 0.95) & (np.abs(height_m + 1.0) < 0.02) & (known > 0)
    assert (floor[on_floor] > 0.8).all()
    assert not furniture_image(levelled_cloud(empty_frame())).any()


def test_shares_of_furniture_add_up(network):
    values = network.describe(levelled_cloud(table_frame()))
    assert values.shape == (network.n_values,)
    assert (values[:N_PIECES] ** 2).sum() == pytest.approx(1.0, abs=0.01)
    assert (values[N_PIECES : 2 * N_PIECES] <= 1.0).all()
    assert not network.describe(levelled_cloud(empty_frame()))[: 2 * N_PIECES].any()


def test_a_convolution_is_that_of_scipy(network):
    from scipy.signal import correlate

    from slam_bof.scenes.furniture_network import _convolve

    image = np.random.default_rng(1).normal(size=(24, 30, 40)).astype(np.float32)
    found = _convolve(image, network.kernel_1, network.bias_1, 2, 1)
    padded = np.pad(image, ((0, 0), (1, 1), (1, 1)))
    expected = [
        correlate(padded, kernel, "valid")[0, ::2, ::2] + bias
        for kernel, bias in zip(network.kernel_1, network.bias_1, strict=True)
    ]
    np.testing.assert_allclose(found, np.maximum(expected, 0.0), atol=1e-4)
    dilated = np.zeros((64, 64, 5, 5), np.float32)
    dilated[:, :, ::2, ::2] = network.kernel_3
    other = np.random.default_rng(2).normal(size=(64, 15, 20)).astype(np.float32)
    np.testing.assert_allclose(
        _convolve(other, network.kernel_3, network.bias_3, 1, 2),
        _convolve(other, dilated, network.bias_3, 1, 1),
        atol=1e-4,
    )


def test_a_classifier_keeps_its_furniture_network(network):
    seen = [levelled_features(frame, furniture=network) for frame, _ in tables(0, 24)]
    labels = [label for _, label in tables(0, 24)]
    small = MlpEnsemble(n_hidden=16, n_networks=1, n_steps=200, n_folds=2)
    fitted = LevelledClassifier.fit(seen, labels, network=small, furniture=network)
    again = LevelledClassifier.from_arrays(fitted.manifest(), fitted.arrays())
    for frame, label in tables(1, 6):
        assert fitted.label(frame).label == label
        np.testing.assert_array_equal(
            again.label(frame).probabilities, fitted.label(frame).probabilities
        )
    with pytest.raises(ValueError, match="without furniture"):
        fitted.label_features(levelled_features(next(tables(1, 1))[0]))


def test_weights_that_do_not_fit_are_refused(network):
    arrays = network.arrays()
    with pytest.raises(ValueError, match="kernel_1 must be"):
        FurnitureNetwork.from_arrays(arrays | {"kernel_1": arrays["kernel_0"]})
    with pytest.raises(ValueError, match="room_bias must be"):
        FurnitureNetwork.from_arrays(arrays | {"room_bias": np.zeros(5)})
    with pytest.raises(ValueError, match="found 10000"):
        FurnitureNetwork.from_arrays(arrays | {"piece_bias": np.full(N_PIECES, 1e4)})
    with pytest.raises(KeyError):
        FurnitureNetwork.from_arrays({"piece": arrays["piece"]})


def furnished(seed, n):
    """Yield tables of two heights, which are furniture 1 and 2, and rooms 0 and 1."""
    for frame, label in tables(seed, n):
        cloud = levelled_cloud(frame)
        height_m = cloud.camera_height_m - cloud.grid_points[..., 1]
        number = 1 + (label == "counter")
        is_table = np.abs(height_m - (0.45, 0.9)[number - 1]) < 0.06
        stride = -(-frame.depth.shape[0] // len(is_table))
        pieces = np.kron(is_table, np.ones((stride, stride), bool)) * np.uint8(number)
        shape = frame.depth.shape
        yield furniture_view(frame, pieces[: shape[0], : shape[1]], number - 1, gravity_camera=None)


def test_a_network_learns_furniture():
    torch = pytest.importorskip("torch")
    from slam_bof.scenes import furniture_training as training

    settings = FurnitureTraining(n_epochs=12, batch_size=8)
    found, again = (fit_furniture(furnished(0, 32), N_PIECES, N_ROOMS, settings) for _ in range(2))
    for name, weights in found.arrays().items():
        np.testing.assert_array_equal(weights, again.arrays()[name])
    right = []
    for frame, label in tables(5, 8):
        values = found.describe(levelled_cloud(frame))
        right.append(values[-N_ROOMS:].argmax() == (label == "counter"))
        number = 1 + (label == "counter")
        assert values[number] > values[3 - number], "more cells of this table than of the other"
    assert np.mean(right) == 1.0

    torch.manual_seed(0)
    layers = training._layers(torch, N_PIECES, N_ROOMS)
    view = next(iter(furnished(1, 1)))
    inputs = torch.tensor(view.image[None].astype(np.float32))
    for _ in range(3):
        training._outputs(torch, layers, inputs, 0.0)
    layers.eval()
    with torch.no_grad():
        _, of_rooms = training._outputs(torch, layers, inputs, 0.0)
    frame = next(tables(1, 1))[0]
    values = training._network(layers).describe(levelled_cloud(frame))
    np.testing.assert_allclose(values[-N_ROOMS:], of_rooms.numpy()[0], atol=0.02)


def test_pieces_must_be_those_of_the_pixels():
    with pytest.raises(ValueError, match="pieces must be"):
        furniture_view(table_frame(), np.zeros((10, 10), np.uint8), 0, gravity_camera=None)
