"""Expected values of the tests in this folder, by an independent implementation in NumPy (f64).

Prints LPIPS of two images from formulas, with networks whose weights come from a formula:
    python expected.py
"""

import numpy as np

# Kernel sizes and strides as in torchvision's models; T marks the features that LPIPS compares.
ALEX = "c64,11,4,2 T p3,2,0 c192,5,1,2 T p3,2,0 c384,3,1,1 T c256,3,1,1 T c256,3,1,1 T"
VGG = (
    "c64,3,1,1 c64,3,1,1 T p2,2,0 c128,3,1,1 c128,3,1,1 T p2,2,0 c256,3,1,1 c256,3,1,1 c256,3,1,1 T p2,2,0 "
    "c512,3,1,1 c512,3,1,1 c512,3,1,1 T p2,2,0 c512,3,1,1 c512,3,1,1 c512,3,1,1 T"
)
SQUEEZE = (
    "c64,3,2,0 T p3,2,1 f16,64 f16,64 T p3,2,1 f32,128 f32,128 T p3,2,1 f48,192 T f48,192 T f64,256 T f64,256 T"
)


def uniform(count, seed):
    """`count` numbers in [0, 1) with 24 bits each: a hash of the index and the seed."""
    bits = (np.arange(count, dtype=np.uint64) + seed * 0x9E3779B9) % 2**32
    for shift, factor in ((16, 0x7FEB352D), (15, 0x846CA68B), (16, 1)):
        bits = ((bits ^ (bits >> np.uint64(shift))) * np.uint64(factor)) % 2**32
    return (bits >> np.uint64(8)).astype(np.float64) / 2**24


class Net:
    def __init__(self, plan):
        self.plan, self.layers = plan.split(), 0

    def conv(self, x, outputs, size, stride, padding):
        """Convolution and ReLU by the sum over the window's taps."""
        self.layers += 1
        inputs = len(x)
        bound = np.sqrt(6 / (inputs * size * size))
        weights = (2 * uniform(outputs * inputs * size * size, self.layers) - 1) * bound
        weights = weights.reshape(outputs, inputs, size, size)
        bias = (2 * uniform(outputs, self.layers + 100) - 1) * 0.1
        x = np.pad(x, ((0, 0), (padding, padding), (padding, padding)))
        height, width = ((side - size) // stride + 1 for side in x.shape[1:])
        y = np.zeros((outputs, height, width)) + bias[:, None, None]
        for i in range(size):
            for j in range(size):
                seen = x[:, i : i + stride * (height - 1) + 1 : stride, j : j + stride * (width - 1) + 1 : stride]
                y += np.einsum("oc,chw->ohw", weights[:, :, i, j], seen)
        return np.maximum(y, 0)

    def taps(self, image):
        """Features [C, H, W] of an image [H, W, 3] in the network's range."""
        x = ((image - [-0.030, -0.088, -0.188]) / [0.458, 0.448, 0.450]).transpose(2, 0, 1)
        self.layers, taps = 0, []
        for layer in self.plan:
            kind, sizes = layer[0], [int(n) for n in layer[1:].split(",") if n]
            if kind == "c":
                x = self.conv(x, *sizes)
            elif kind == "f":
                x = self.conv(x, sizes[0], 1, 1, 0)
                x = np.concatenate([self.conv(x, sizes[1], 1, 1, 0), self.conv(x, sizes[1], 3, 1, 1)])
            elif kind == "p":
                x = pool(x, *sizes)
            else:
                taps.append(x)
        return taps


def pool(x, size, stride, partial):
    rounded = np.ceil if partial else np.floor
    height, width = (int(rounded((side - size) / stride)) + 1 for side in x.shape[1:])
    return np.array(
        [[x[:, i * stride : i * stride + size, j * stride : j * stride + size].max((1, 2)) for j in range(width)] for i in range(height)]
    ).transpose(2, 0, 1)


def maps(plan, a, b):
    unit = lambda x: x / (np.sqrt((x * x).sum(0)) + 1e-10)
    pairs = zip(Net(plan).taps(a), Net(plan).taps(b))
    return [np.tensordot(0.5 * uniform(len(x), 200 + tap), (unit(x) - unit(y)) ** 2, 1) for tap, (x, y) in enumerate(pairs)]


def enlarge(x, sides):
    """Bilinear along each axis, centres at one half, edges repeated."""
    for axis, side in enumerate(sides):
        old = x.shape[axis]
        place = np.clip((np.arange(side) + 0.5) * old / side - 0.5, 0, old - 1)
        low = np.floor(place).astype(int)
        high = np.minimum(low + 1, old - 1)
        share = (place - low).reshape((-1, 1) if axis == 0 else (1, -1))
        x = np.take(x, low, axis) * (1 - share) + np.take(x, high, axis) * share
    return x


def images(side):
    y, x, c = np.meshgrid(np.arange(side), np.arange(side), np.arange(3), indexing="ij")
    a = (3 * x + 5 * y + 40 * c + (x * x + 3 * y * y + 7 * x * y + 11 * c) % 64) % 256
    b = np.clip(a + (31 * x + 17 * y + 7 * c + 3 * ((x * y) % 13)) % 41 - 20, 0, 255)
    b = np.where((x >= 16) & (x < 40) & (y >= 12) & (y < 30), 3 * b // 4, b)
    return a / 255, b / 255


def main():
    for name, plan, side in (("alex", ALEX, 64), ("vgg", VGG, 32), ("squeeze", SQUEEZE, 66)):
        a, b = images(side)
        for label, pair in (("2v-1", (2 * a - 1, 2 * b - 1)), ("v", (a, b))):
            found = maps(plan, *pair)
            print(name, label, repr(float(sum(m.mean() for m in found))), [m.shape for m in found])
    a, b = images(64)
    y, x = np.mgrid[:64, :64]
    mask = (x - 30) ** 2 + 2 * (y - 22) ** 2 <= 324
    masked = [2 * image * mask[..., None] - 1 for image in (a, b)]
    print("alex masked", repr(float(sum(enlarge(m, (64, 64)) for m in maps(ALEX, *masked))[mask].mean())))


main()
