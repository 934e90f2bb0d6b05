"""Masks by SAM or MobileSAM in ONNX, for a run or for a recorded folder.

Export or download the encoder, (1, 3, 1024, 1024) -> embeddings, and the decoder of the project
segment-anything (``scripts/export_onnx_model.py``); ``pip install onnxruntime``. Not run by our
tests, which have no weights. In a run::

    parts:
      segmentation:
        name: "onnx_segmenter:Segmenter"
        options: {encoder: e.onnx, decoder: d.onnx}

For a folder: ``python onnx_segmenter.py FOLDER e.onnx d.onnx``, then
``feasigrasp track --folder FOLDER``.
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image


class Segmenter:
    """Follows what is nearest in the first image: each mask's middle prompts the next one."""

    def __init__(self, camera, encoder="encoder.onnx", decoder="decoder.onnx"):
        import onnxruntime

        self._encoder, self._decoder = map(onnxruntime.InferenceSession, (encoder, decoder))
        self._prompt = None

    def __call__(self, color, depth, time):
        height, width = depth.shape
        scale = 1024.0 / max(height, width)
        if self._prompt is None:
            nearest = np.where(np.isfinite(depth) & (depth > 0.0), depth, np.inf).argmin()
            self._prompt = np.array(np.unravel_index(nearest, depth.shape))[::-1]
        small = Image.fromarray(color).resize((round(scale * width), round(scale * height)))
        pixels = (np.asarray(small, dtype=np.float32) - [123.7, 116.3, 103.5]) / [58.4, 57.1, 57.4]
        image = np.zeros((1, 3, 1024, 1024), dtype=np.float32)
        image[0, :, : pixels.shape[0], : pixels.shape[1]] = pixels.transpose(2, 0, 1)
        name = self._encoder.get_inputs()[0].name
        inputs = {
            "image_embeddings": self._encoder.run(None, {name: image})[0],
            "point_coords": np.array([[scale * self._prompt, [0, 0]]], dtype=np.float32),
            "point_labels": np.array([[1, -1]], dtype=np.float32),
            "mask_input": np.zeros((1, 1, 256, 256), dtype=np.float32),
            "has_mask_input": np.zeros(1, dtype=np.float32),
            "orig_im_size": np.array([height, width], dtype=np.float32),
        }
        masks, scores = self._decoder.run(None, inputs)[:2]
        mask = masks[0, scores[0].argmax()] > 0.0
        if mask.any():
            self._prompt = np.median(np.argwhere(mask), axis=0)[::-1]
        return mask


if __name__ == "__main__":
    from feasigrasp.recordings import read_depth_folder

    folder, segmenter = read_depth_folder(sys.argv[1]), Segmenter(None, *sys.argv[2:4])
    for k, file in enumerate(folder.files):
        mask = segmenter(folder.color(k), folder.depth(k), folder.times[k])
        target = Path(sys.argv[1]) / "masks" / f"{file.stem}.png"
        target.parent.mkdir(exist_ok=True)
        Image.fromarray(mask).resize(Image.open(file).size, Image.Resampling.NEAREST).save(target)
