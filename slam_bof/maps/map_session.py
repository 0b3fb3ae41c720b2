"""A session of a map: begun or resumed, mapped on, and finished whatever happens."""

from __future__ import annotations

import importlib.metadata
import logging
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Self

from slam_bof.core import keep_going
from slam_bof.errors import MapError, SlamBofError
from slam_bof.scenes import MapRoom, label_map, model as models
from slam_bof.slam import Config, LoopCloser, config as configs
from slam_bof.store import MapStore, MapWriter, Session, SessionResult, replay_keyframes
from slam_bof.types import Intrinsics, Scene, Trajectory

__all__ = [
    "MapSession",
    "check_session",
    "finish_map",
    "finish_session",
    "restore_session",
    "with_model_of",
]

LEFT_OUT_REASON = "inconsistent with the other loops in the final optimisation"

logger = logging.getLogger(__name__)


class MapSession:
    """One session of a map beside your own odometry: a context manager with a ``closer``.

    Entering the block opens the map or makes a new one; leaving it finishes the session, also
    after an exception: the poses of the whole map are optimised, its labels smoothed and its rooms
    found. What was processed until then is saved. A session that a killed program has left
    unfinished is finished first.

    Examples
    --------
    >>> with MapSession.open("home.db", camera=intrinsics) as session:  # doctest: +SKIP
    ...     for frame, T_odom_camera in my_odometry:
    ...         step = session.closer.process(frame, T_odom_camera)
    >>> session.trajectory  # doctest: +SKIP
    """

    trajectory: Trajectory | None = None
    """``T_map_camera`` of every frame of the session, once it is finished."""

    def __init__(
        self, store: MapStore, session: Session, config: Config, closer: LoopCloser
    ) -> None:
        self.store, self.session, self.closer = store, session, closer
        self._config = config
        self._writer = MapWriter(store)
        closer.journal = self._writer.write

    @classmethod
    def open(
        cls,
        path: Path | str,
        *,
        camera: Intrinsics | None = None,
        config: Config | str | Path | None = None,
        sequence: str = "",
        background: bool = False,
    ) -> Self:
        """Open a map for another session, or make a new one if there is no file.

        Parameters
        ----------
        path
            The map.db.
        camera
            The depth camera, to be checked at once against that of the map. By default a frame of
            another camera is refused when it is processed.
        config
            A configuration, the name of a preset or of a YAML file. By default that of the map's
            last session, or ``indoor`` for a new map.
        sequence
            Name of the session, for ``slam-bof map info``.
        background
            Whether keyframes are processed beside the caller; see ``LoopCloser.from_config``.

        Raises
        ------
        MapError
            If the map is damaged, another program writes to it, or its camera or model is
            another.
        """
        path = Path(path)
        with ExitStack() as on_error:
            is_new = not path.exists()
            store = MapStore.create(path) if is_new else MapStore.open(path, read_only=False)
            on_error.enter_context(store)
            finish_map(store)
            sessions = store.sessions()
            if config is None and sessions:
                where = f"{path}: session {sessions[-1].id}"
                config = configs.parse_saved(sessions[-1].config, where)
            if not isinstance(config, Config):
                config = configs.resolve(str(config or "indoor"))
            config = with_model_of(store, configs.complete(config))
            closer = LoopCloser.from_config(config, background=background)
            on_error.callback(closer.close)
            check_session(store, camera, sequence or "this session", closer)
            session = Session(
                id=len(sessions),
                dataset="python",
                sequence=sequence,
                config=configs.dump(config),
                seed=config.seed,
                version=importlib.metadata.version("slam-bof"),
            )
            restore_session(closer, store, session, is_new=True)
            on_error.pop_all()
        return cls(store, session, config, closer)

    def wait(self) -> None:
        """Wait until all keyframes so far are in the map; the store may be read until the next."""
        self.closer.drain()
        self._writer.wait()

    def finish(self) -> Trajectory:
        """Finish the session, close the map and return ``T_map_camera`` of every frame.

        Leaving the ``with`` block does this.
        """
        with self.store:
            with self._writer:
                self.closer.drain()
                self.closer.journal = None
            self.trajectory = self.closer.finish()
            finish_session(self.closer, self.store, self.session, self._config)
        return self.trajectory

    def __enter__(self) -> Self:
        """Return the session itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Finish the session and close the map."""
        if self.trajectory is None:
            self.finish()


def restore_session(closer: LoopCloser, store: MapStore, session: Session, *, is_new: bool) -> None:
    """Restore a new closer from a map, to map on in a session.

    If the session ``is_new``, it is begun in both; otherwise the closer is where the session's
    last saved keyframe left it.

    Raises
    ------
    MapError
        If a row is damaged, or the map holds what no run has left.
    """
    records = replay_keyframes(store, reopened_session=None if is_new else session.id)
    try:
        closer.restore(records)
    except SlamBofError:
        raise
    except (ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError, ValueError) as e:
        raise MapError(
            f"{store.path}: found what cannot be continued ({' '.join(repr(e).split())[:200]}), "
            "expected what a run has left"
        ) from e
    while closer.map.session < session.id:
        closer.begin_session()
    if is_new:
        store.set_parameters({"model": closer.map.model_hash})
        store.begin_session(session)


def finish_session(
    closer: LoopCloser,
    store: MapStore,
    session: Session,
    config: Config,
    *,
    warn: Callable[[str], None] = logger.warning,
) -> tuple[list[Scene | None], list[MapRoom]]:
    """Save the result of a session, after ``LoopCloser.finish``, for the whole map.

    ``warn`` is called with a message if rooms and labels cannot be computed.

    Returns
    -------
    smoothed : list of Scene or None
        The smoothed label of each keyframe of the map.
    rooms : list of MapRoom
        The rooms of the map.
    """
    T_map_camera = closer.map.poses()
    smoothed, rooms = [keyframe.smoothed for keyframe in closer.map.keyframes], list[MapRoom]()
    with keep_going("rooms and smoothed labels", warn):
        smoothed, rooms = label_map(
            closer.map.keyframes,
            T_map_camera,
            config.labels,
            config.rooms,
            components=closer.map.components,
            anchors=closer.map.anchors,
        )
    store.finish(
        session.id,
        SessionResult(
            frames=closer.frames_since_keyframe,
            T_map_camera=T_map_camera,
            smoothed=smoothed,
            rooms=rooms,
            left_out=closer.map.loops_left_out,
            reason=LEFT_OUT_REASON,
        ),
    )
    return smoothed, rooms


def finish_map(store: MapStore) -> Session | None:
    """Finish the session that an interrupted run has left, from what is saved in the map alone.

    Frames after its last keyframe are lost. Return the session, or None if all are finished.
    """
    unfinished = [session for session in store.sessions() if not session.is_finished]
    for session in unfinished:
        config = configs.parse_saved(session.config, f"{store.path}: session {session.id}")
        config = with_model_of(store, config)
        closer = LoopCloser.from_config(config)
        restore_session(closer, store, session, is_new=False)
        closer.finish()
        finish_session(closer, store, session, config)
        logger.info("%s: session %d was interrupted; finished", store.path, session.id)
    return unfinished[-1] if unfinished else None


def check_session(
    store: MapStore, camera: Intrinsics | None, sequence: str, closer: LoopCloser
) -> None:
    """Check that a session of a camera, by a closer with its model, can be added to a map."""
    model, known = closer.map.model_hash, store.intrinsics()
    found = store.parameters().get("model", model)
    if models.has_words_of(found, closer.map.model_name):
        logger.warning(
            "%s: made with an earlier %s model, %s; its labels are those stored, and new "
            "keyframes get theirs from %s",
            store.path,
            closer.map.model_name,
            found[:12],
            model[:12],
        )
    elif found != model:
        raise MapError(
            f"{store.path}: found a map made with model {found[:12]}, expected {model[:12]}: "
            "all sessions of a map use one model"
        )
    if known is not None and camera is not None and not camera.is_close(known):
        raise MapError(
            f"{store.path}: found {known}, expected {camera}, the camera of "
            f"{sequence}: all sessions of a map use one camera"
        )


def with_model_of(store: MapStore, config: Config) -> Config:
    """Return the configuration with the model that the map was made with, if it is included."""
    name = models.name_by_hash(config.model, store.parameters().get("model"))
    return config.model_copy(update={"model": name})
