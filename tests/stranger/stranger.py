from dataclasses import replace
import numpy as np
from slam_bof import DepthFrame, Intrinsics, ports
from slam_bof.errors import DatasetError
from slam_bof_plugins.verifier_projective import ProjectiveVerifier

class NpzSequence(ports.Dataset):  # depth.npz: depth (N, H, W) uint16 mm; camera fx, fy, cx, cy
    name, sequence = "npz", "depth.npz"
    @classmethod
    def recognises(cls, path): return (path / cls.sequence).is_file()
    @classmethod
    def open(cls, path):
        if not cls.recognises(path): raise DatasetError(f"{path}: found no {cls.sequence}")
        self, file = cls(), np.load(path / cls.sequence)
        self.depth, (_, height, width) = file["depth"], file["depth"].shape
        self.intrinsics = Intrinsics(width, height, *file["camera"].tolist())
        return self
    def __len__(self): return len(self.depth)
    def frame(self, index): return DepthFrame(index / 30, self.depth[index], self.intrinsics)

class Still(ports.Odometry):  # knows nothing: tracking corrects what it can
    def process(self, frame): return np.eye(4)

class Picky(ProjectiveVerifier):
    def verify(self, query, matches, **how):
        found = super().verify(query, matches, **how)
        return [v if v.overlap > 0.5 else replace(v, accepted=False, reason="few meet") for v in found]
