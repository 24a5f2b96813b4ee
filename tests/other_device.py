"""A second device made of the CPU: tensors that refuse to meet the CPU's, as a GPU's do.

Under :class:`OtherDevice`, whatever is made on or moved to "cuda" becomes a :class:`Foreign`
tensor: its values stay on the CPU behind it, and every operation that mixes it with tensors of
the CPU raises as CUDA does. As CUDA does, it lets numbers without dimensions pass, lets CPU
tensors index it, and refuses ``.numpy()`` and generators of the CPU. To torch it lives on the
device "meta", the one foreign device that a torch without CUDA knows; whoever asks is told "cuda".
"""

from __future__ import annotations

import torch
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_flatten, tree_map, tree_unflatten

aten = torch.ops.aten
INDEXING = {aten.index.Tensor, aten.index_put_.default, aten.index_put.default,
            aten._index_put_impl_.default}  # fmt: skip
ACROSS = {aten._to_copy.default, aten.copy_.default}


class Foreign(torch.Tensor):
    """Holds a CPU tensor and keeps it from others."""

    @staticmethod
    def __new__(cls, held):
        return torch.Tensor._make_wrapper_subclass(
            cls, held.shape, strides=held.stride(), storage_offset=held.storage_offset(),
            dtype=held.dtype, device="meta",
        )  # fmt: skip

    def __init__(self, held):
        self.held = held

    def __repr__(self):
        return f"Foreign({self.held!r})"

    # What torch does outside its dispatcher, where only the real device counts.
    def tolist(self):
        return self.held.tolist()

    def numpy(self):
        raise TypeError("can't convert cuda:0 device type tensor to numpy. Use Tensor.cpu()")

    def __array__(self, dtype=None, copy=None):
        return self.numpy()

    @classmethod
    def __torch_dispatch__(cls, func, types, args=(), kwargs=None):
        return carry_out(func, args, kwargs or {})


def is_cuda(device):
    return device is not None and torch.device(device).type in ("cuda", "meta")


def as_meta(value):
    """A device as torch must be told it."""
    named = isinstance(value, torch.device) and value.type == "cuda"
    return torch.device("meta") if named else value


def refuse_mixture(func, tensors, indexing):
    """Raise where a tensor of the CPU meets foreign ones."""
    if not any(isinstance(t, Foreign) for t in tensors):
        if indexing and any(isinstance(t, Foreign) for t in indexing):
            raise RuntimeError(
                f"indices should be on the same device as the indexed (cpu), not cuda: {func}"
            )
        return
    if any(not isinstance(t, Foreign) and t.dim() > 0 for t in tensors):
        raise RuntimeError(
            f"Expected all tensors to be on the same device, but found cuda:0 and cpu: {func}"
        )


def carry_out(func, args, kwargs):
    """The operation on the tensors behind, its results where they belong."""
    wanted = kwargs.get("device")
    flat, shape = tree_flatten((args, kwargs))
    tensors = [a for a in flat if isinstance(a, torch.Tensor)]
    foreign = any(isinstance(t, Foreign) for t in tensors)
    if func in INDEXING:
        index = [t for t in args[1] if isinstance(t, torch.Tensor)]
        refuse_mixture(
            func, [args[0], *(a for a in args[2:] if isinstance(a, torch.Tensor))], index
        )
        foreign = isinstance(args[0], Foreign)
    elif func not in ACROSS:
        refuse_mixture(func, tensors, [])
    if func is aten._local_scalar_dense.default:
        return func(getattr(args[0], "held", args[0]))
    goes = is_cuda(wanted) if wanted is not None else foreign
    generator = kwargs.get("generator")
    if goes and isinstance(generator, torch.Generator):
        raise RuntimeError("Expected a 'cuda' device type for generator but found 'cpu'")
    flat = [a.held if isinstance(a, Foreign) else a for a in flat]
    args_held, kwargs_held = tree_unflatten(flat, shape)
    if "device" in kwargs_held and wanted is not None:
        kwargs_held["device"] = torch.device("cpu")
    kwargs_held.pop("pin_memory", None)
    result = func(*args_held, **kwargs_held)
    if func._schema.name.endswith("_") and isinstance(args[0], torch.Tensor):
        return args[0]
    if kwargs.get("out") is not None:
        return kwargs["out"]
    if not goes:
        return result
    return tree_map(lambda r: Foreign(r) if isinstance(r, torch.Tensor) else r, result)


class Dispatch(TorchDispatchMode):
    """Factories that make tensors on "cuda" see no tensor of ours: they are caught here."""

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        return carry_out(func, args, kwargs or {})


class OtherDevice(TorchFunctionMode):
    """Where "cuda" is there, made of the CPU."""

    def __torch_function__(self, func, types, args=(), kwargs=None):
        kwargs = dict(kwargs or {})
        if func == torch.Tensor.device.__get__ and isinstance(args[0], Foreign):
            return torch.device("cuda:0")
        if func in (torch.tensor, torch.as_tensor, torch.asarray) and is_cuda(kwargs.get("device")):
            # These look for a driver before they dispatch.
            kwargs["device"] = "cpu"
            return Foreign(func(*args, **kwargs))
        if func in (torch.Tensor.to, torch.Tensor.cuda):
            target = kwargs.pop("device", None)
            rest = []
            for a in args[1:]:
                if isinstance(a, str | torch.device):
                    target = a
                elif isinstance(a, torch.Tensor):
                    target, kwargs["dtype"] = a.device, a.dtype
                else:
                    rest.append(a)
            return moved(args[0], func is torch.Tensor.cuda or target, rest, kwargs)
        if func is torch.Tensor.cpu:
            return moved(args[0], "cpu", [], {})
        if is_cuda(kwargs.get("device")):
            kwargs["device"] = torch.device("meta")
        return func(*tree_map(as_meta, args), **kwargs)

    def __enter__(self):
        self.dispatch = Dispatch()
        self.dispatch.__enter__()
        return super().__enter__()

    def __exit__(self, *error):
        super().__exit__(*error)
        self.dispatch.__exit__(*error)


def moved(tensor, target, rest, kwargs):
    """A tensor on a device, with the dtype asked for: ``target`` None stays where it is."""
    inside = tensor.held if isinstance(tensor, Foreign) else tensor
    inside = inside.to(*rest, **kwargs) if rest or kwargs else inside
    away = isinstance(tensor, Foreign) if target is None else target is True or is_cuda(target)
    if away == isinstance(tensor, Foreign) and inside is getattr(tensor, "held", tensor):
        return tensor
    return Foreign(inside.clone()) if away else inside.clone()
