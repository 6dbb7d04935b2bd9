"""The deformation: rigid bodies or control points, then a field.

Features of position and time become residuals of the Gaussians.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from gaussray.geometry import multiply, normalize_quaternion, product, rotation_matrix
from gaussray.runtime.devices import numba_module, runs_machine_code
from gaussray.scene.bodies import Bodies, body_of, body_pose_at
from gaussray.scene.control_points import ControlPoints, control_motion, with_fixed_weights
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.harmonics import harmonic_basis
from gaussray.scene.planes import Planes, features


# Largest change of log scale: unbounded, a Gaussian whose motion is not yet found grows until it
# covers where it might be, and every ray pays for it.
STRETCH = 0.3
# Largest change of the logarithm of the colour: from sun to deep shade.
CONTRAST = 3.0
# Gaussians of a piece of the gradient of a matrix on a GPU.
_GRADIENT_PIECE = 512
# Gaussians for which a CPU computes the network at a time.
_NETWORK_BLOCK = 1024
# The fields of a `Deformation` that are output heads of its network; each may be None.
HEADS = ("mean", "rotation", "scale", "tint")


class FieldOptions(eqx.Module):
    """Size of the deformation field (4D-GRT: planes 128 times 1, 2, 4, 8, width 128).

    Args:
        sides: resolutions of the spatial planes, one per scale.
        instants: rows of the time planes; 0 is one per timestamp of the capture.
        channels: features per scale.
        width: width of the network's layers.

    Raises:
        ValueError: A value is too small.
    """

    sides: tuple[int, ...] = eqx.field(static=True, default=(16, 32))
    instants: int = eqx.field(static=True, default=0)
    channels: int = eqx.field(static=True, default=16)
    width: int = eqx.field(static=True, default=64)

    def __check_init__(self):
        if not self.sides or min(self.sides) < 2:
            raise ValueError(f"field.sides must hold resolutions of at least 2, got {self.sides}.")
        if self.instants < 0 or self.instants == 1:
            raise ValueError(f"field.instants must be 0 or at least 2, got {self.instants}.")
        for name in ("channels", "width"):
            if getattr(self, name) < 1:
                raise ValueError(f"field.{name} must be at least 1, got {getattr(self, name)}.")


class Layer(eqx.Module):
    """An affine map of features: x W + b."""

    weight: Float[Array, "inputs outputs"]
    bias: Float[Array, " outputs"]

    def __call__(self, x: Float[Array, "gaussians inputs"]) -> Float[Array, "gaussians outputs"]:
        on_cpu = jax.default_backend() == "cpu"
        multiply_all = _plain_product if on_cpu else _matrix_product
        return multiply_all(x, self.weight) + self.bias[None]


def _plain_product(x: Array, weight: Array) -> Array:
    return product("ni,io->no", x, weight)


def _matrix_product_backward(saved, g):
    (x, weight), g = saved, jnp.asarray(g)
    return product("no,io->ni", g, weight), _sum_of_outer_products(x, g)


_matrix_product = jax.custom_vjp(_plain_product)
_matrix_product.defvjp(
    lambda x, weight: (_plain_product(x, weight), (x, weight)), _matrix_product_backward
)


def _sum_of_outer_products(x: Array, g: Array) -> Array:
    """x^T g, in pieces that are then added: NVIDIA's library gives the few numbers of the result to
    a few blocks, each of which would go through all Gaussians."""
    return jnp.sum(product("pni,pno->pio", *(_pieces(v, _GRADIENT_PIECE) for v in (x, g))), axis=0)


def _pieces(rows: Array, size: int) -> Array:
    """Rows in pieces of a size, with rows of zeros at the end."""
    count, width = -(-len(rows) // size), rows.shape[1]
    # The count is named, as rows of no width do not tell it.
    return jnp.pad(rows, ((0, -len(rows) % size), (0, 0))).reshape(count, size, width)


class Deformation(eqx.Module):
    """A deformation field (4DGaussians, 4D-GRT): rigid bodies or control points, then residuals of
    a network.

    Args:
        bodies: rigid bodies, which move first.
        planes: feature planes over space and time.
        trunk: the hidden layer of the network.
        mean: two-layer head of the translation; a head that is None adds nothing.
        rotation: head of the quaternion.
        scale: head of the log scale.
        tint: head of the logarithm of the colour.
        light: spherical harmonics of degree 2 of the light on a surface, by its normal.
        control: control points, with which all Gaussians move first, instead of with bodies; None
            if bodies do.
    """

    bodies: Bodies
    planes: Planes
    trunk: Layer
    mean: tuple[Layer, Layer] | None
    rotation: tuple[Layer, Layer] | None
    scale: tuple[Layer, Layer] | None
    tint: tuple[Layer, Layer] | None
    light: Float[Array, "9 3"]
    control: ControlPoints | None = None

    @property
    def instants(self) -> Float[Array, " instants"]:
        """The timestamps at which the motion was sampled."""
        return self.bodies.time if self.control is None else self.control.time

    def __call__(
        self, gaussians: Gaussians, time: Float[Array, ""], *, held: bool = False
    ) -> Gaussians:
        """The Gaussians at a time (`deform`)."""
        return deform(gaussians, self, time, held=held)


def head_output(
    head: tuple[Layer, Layer], hidden: Float[Array, "gaussians width"]
) -> Float[Array, "gaussians outputs"]:
    """Output of a head.

    Args:
        head: the two layers.
        hidden: features of the trunk.
    """
    first, last = head
    return last(jax.nn.relu(first(jax.nn.relu(hidden))))


def initial_deformation(
    key: PRNGKeyArray,
    planes: Planes,
    bodies: Bodies,
    *,
    width: int,
    control: ControlPoints | None = None,
) -> Deformation:
    """A deformation field that is the identity: Xavier's uniform weights, last layers zero.

    Args:
        key: random key of the weights.
        planes: the feature planes.
        bodies: the rigid bodies.
        width: width of the network's layers.
        control: the control points; None for none.
    """
    keys = iter(jax.random.split(key, 5))
    dtype = planes.lower.dtype

    def layer(inputs: int, outputs: int) -> Layer:
        bound = (6 / (inputs + outputs)) ** 0.5
        weight = jax.random.uniform(next(keys), (inputs, outputs), dtype, -bound, bound)
        return Layer(weight, jnp.zeros(outputs, dtype))

    def head(outputs: int) -> tuple[Layer, Layer]:
        last = Layer(jnp.zeros((width, outputs), dtype), jnp.zeros(outputs, dtype))
        return layer(width, width), last

    trunk = layer(planes.width, width)
    heads = head(3), head(4), head(3), head(3)
    return Deformation(bodies, planes, trunk, *heads, jnp.zeros((9, 3), dtype), control)


def deform(
    gaussians: Gaussians, deformation: Deformation, time: Float[Array, ""], *, held: bool = False
) -> Gaussians:
    """Deform Gaussians: their state at a time.

    Each Gaussian first moves with its rigid body, or with the control points around it; the heads
    then add residuals to mean, unit quaternion and log scale. A body's pose is a few numbers that
    all pixels of the body determine: a field alone, as in HexPlane, loses a body that moves by its
    own size and turns between two timestamps.

    Args:
        gaussians: the Gaussians before deformation.
        deformation: the deformation field.
        time: in the capture's unit.
        held: whether derivatives leave out, as fits do, how the motion and the light depend on
            where a Gaussian is and how it is turned. A Gaussian must not move to another one's
            place to find a better motion, and fits are faster so.
    """
    position, quat, control = gaussians.mean, gaussians.quat, deformation.control
    if held:
        position, quat = jax.lax.stop_gradient((position, quat))
        control = None if control is None else with_fixed_weights(control)
    residual = _residuals(deformation, features(deformation.planes, position, time))
    if control is not None:
        pivot, (path, turn) = position, control_motion(control, position, time)
    else:
        pivot, path, turn = _body_motion(deformation.bodies, position, time)
    arm = product("nij,nj->ni", rotation_matrix(turn), gaussians.mean - pivot)
    rotated = multiply(turn, normalize_quaternion(gaussians.quat))
    # The disc's axis, outwards: the light on a surface depends on its normal.
    normal = rotation_matrix(quat)[:, :, 2]
    inward = jnp.sum(normal * (position - pivot), axis=-1, keepdims=True) < 0
    facing = rotation_matrix(jax.lax.stop_gradient(turn) if held else turn)
    normal = product("nij,nj->ni", facing, normal)
    normal = jnp.where(inward, -normal, normal)
    shade = product("nh,hc->nc", jnp.stack(harmonic_basis(normal.T, 9), axis=-1), deformation.light)
    stretch = STRETCH * jnp.tanh(residual["scale"] / STRETCH)
    return Gaussians(
        mean=pivot + path + arm + residual["mean"],
        quat=rotated + residual["rotation"],
        scale=gaussians.scale * jnp.exp(stretch),
        opacity=gaussians.opacity,
        harmonics=gaussians.harmonics,
        tint=jnp.exp(CONTRAST * jnp.tanh((shade + residual["tint"]) / CONTRAST)),
    )


def register_machine_code() -> None:
    """Make known to XLA what deformation calls on a CPU in a program from an earlier process."""
    if runs_machine_code():
        numba_module("gaussray.scene.plane_code").register_plane_samples()
        numba_module("gaussray.scene.skinning_code").register_blend()


def _residuals(
    deformation: Deformation, inputs: Float[Array, "gaussians features"]
) -> dict[str, Array]:
    """Outputs of all heads by their names, 0 of those that are None.

    The heads are one network, whose last layers are the blocks of a matrix: many small products
    leave a GPU idle. A CPU computes some Gaussians at a time, so that their layers stay in its
    caches.
    """
    zero = jnp.zeros((), inputs.dtype)
    heads = {name: getattr(deformation, name) for name in HEADS}
    present = {name: head for name, head in heads.items() if head is not None}
    outputs: dict[str, Array] = dict.fromkeys(HEADS, zero)
    if not present:
        return outputs
    first, last = zip(*present.values(), strict=True)
    inner = Layer(
        jnp.concatenate([layer.weight for layer in first], axis=1),
        jnp.concatenate([layer.bias for layer in first]),
    )
    outer = Layer(
        jax.scipy.linalg.block_diag(*(layer.weight for layer in last)),
        jnp.concatenate([layer.bias for layer in last]),
    )

    def network(x: Array) -> Array:
        return head_output((inner, outer), deformation.trunk(x))

    count, block = len(inputs), _NETWORK_BLOCK
    if jax.default_backend() == "cpu" and count > block:
        found = jax.lax.map(network, _pieces(inputs, block)).reshape(-1, len(outer.bias))[:count]
    else:
        found = network(inputs)
    ends = np.cumsum([len(layer.bias) for layer in last])[:-1]
    return outputs | dict(zip(present, jnp.split(found, ends, axis=1), strict=True))


def _body_motion(bodies: Bodies, position: Array, time: Array) -> tuple[Array, Array, Array]:
    """Pivot, path and turn of each Gaussian's body; those of no body rest."""
    path, turn = body_pose_at(bodies, time)
    zero = jnp.zeros((1, 3), path.dtype)
    identity = jnp.zeros((1, 4), turn.dtype).at[:, 0].set(1)
    body = body_of(bodies, position)
    pivot = jnp.concatenate([bodies.pivot, zero])[body]
    return pivot, jnp.concatenate([path, zero])[body], jnp.concatenate([turn, identity])[body]
