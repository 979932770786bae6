"""How numba compiles a hot function: its passes, without what none of those needs, and what it asks again and again asked once.

numba is written for functions that are compiled one at a time, between other things. Here hundreds are, one after another, and all
but LLVM's part of the time is Python of numba's. What stands here spares a third of that, and changes no byte of the code that is
made. It reaches into parts that numba keeps to itself: build.py names the one version that it is for.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from contextlib import nullcontext
from functools import cache
from typing import Any

from numba import types
from numba.core import base, errors, ir, postproc, transforms
from numba.core.compiler import CompilerBase
from numba.core.compiler_machinery import PassManager, _pass_registry, register_pass
from numba.core.cpu import CPUContext
from numba.core.errors import LoweringError, TypingError
from numba.core.interpreter import Interpreter
from numba.core.lowering import Lower
from numba.core.registry import CPUDispatcher, cpu_target
from numba.core.typed_passes import NativeLowering, NoPythonBackend, NopythonTypeInference, PreLowerStripPhis
from numba.core.types.functions import BaseFunction
from numba.core.typing import Context
from numba.core.untyped_passes import (
    FixupArgs,
    GenericRewrites,
    IRProcessing,
    ReconstructSSA,
    TranslateByteCode,
)

_OPTIONS = {
    "nopython": True, "nogil": True, "error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True,
}  # fmt: skip

_OPERATORS = frozenset(f for f in vars(operator).values() if callable(f))


class _Looking:
    """A context that numba has look, thousands of times, for what has been registered since: it looks where something has been."""

    _registries: dict[Any, Any]
    _lists: tuple[list[Any], ...] = ()
    _known = -1

    def refresh(self) -> None:
        """numba's; see there."""
        if (now := sum(map(len, self._lists))) != self._known:
            super().refresh()  # type: ignore[misc]
            self._lists = tuple(v for each in self._registries for v in vars(each).values() if isinstance(v, list))
            self._known = now


class _Typing(_Looking, Context):
    """Remembers what operators and functions of numba's own give for which types: numba asks each of their forms each time."""

    def __init__(self) -> None:
        super().__init__()
        self._found: dict[Any, Any] = {}
        self._operators: dict[Any, Any] = {}

    def resolve_function_type(self, func: Any, args: Any, kws: Any) -> Any:
        """numba's; see there."""
        if kws or isinstance(func, (str, types.Dispatcher)):
            return super().resolve_function_type(func, args, kws)
        asked = func, tuple(args)
        found = self._found.get(asked)
        if found is None:
            found = self._found[asked] = super().resolve_function_type(func, args, kws)
        return found

    def resolve_value_type(self, val: Any) -> Any:
        """numba's; see there."""
        if not callable(val) or val not in _OPERATORS:
            return super().resolve_value_type(val)
        found = self._operators.get(val)
        if found is None:
            found = self._operators[val] = super().resolve_value_type(val)
        return found


class _Target(_Looking, CPUContext):
    """Asks LLVM for the size of a type once."""

    def init(self) -> None:
        super().init()
        self._sizes: dict[Any, int] = {}

    def refresh(self) -> None:
        """numba's; see there."""
        super().refresh()
        self.typing_context.refresh()

    def get_abi_sizeof(self, ty: Any) -> int:
        """numba's; see there."""
        found = self._sizes.get(ty)
        if found is None:
            found = self._sizes[ty] = super().get_abi_sizeof(ty)
        return found


vars(cpu_target)["_toplevel_typing_context"] = _Typing()
vars(cpu_target)["_toplevel_target_context"] = _Target(cpu_target.typing_context, "cpu")

base._has_loc = cache(base._has_loc)  # asked of each piece of code that is lowered

_ask = BaseFunction.get_call_type


def _call_type(self: Any, context: Any, args: Any, kws: Any) -> Any:
    """What a function of numba's gives for these types. It tries a plain number before the literal one that it is, and so
    `x + 1` and `x + 2` ask the same."""
    if kws:
        return _ask(self, context, args, kws)
    found = vars(self).setdefault("_found", {})
    given = tuple(args)
    signature = found.get(given)
    if signature is None:
        plain = tuple(map(types.unliteral, given))
        if plain != given and all(isinstance(a, (types.Number, types.Boolean)) for a in plain):
            try:
                signature = _call_type(self, context, plain, kws)
            except TypingError:
                signature = _ask(self, context, given, kws)
        else:
            signature = _ask(self, context, given, kws)
        found[given] = signature
    return signature


BaseFunction.get_call_type = _call_type  # type: ignore[method-assign]

_process = postproc.PostProcessor.run


def _processed(self: Any, emit_dels: bool = False, extend_lifetimes: bool = False) -> None:
    """After each pass numba looks where each variable lives, of which only generators and what counts holders make use."""
    if emit_dels or self.func_ir.is_generator:
        _process(self, emit_dels, extend_lifetimes)
        return
    self.func_ir.blocks = transforms.canonicalize_cfg(self.func_ir.blocks)
    self.func_ir.variable_lifetime = postproc.VariableLifetime(self.func_ir.blocks)
    self.func_ir.generator_info = None


postproc.PostProcessor.run = _processed  # type: ignore[method-assign]

_errors: Any = errors  # it has names that type checkers do not see
_NOTHING = nullcontext()
_errors.WarningsFixer.catch_warnings = lambda self, filename=None, lineno=None: _NOTHING
"""For each thing that it infers numba would catch its own warnings and say them later."""


class _Passes(PassManager):
    """Runs passes, and nothing beside: numba's own run tells listeners of each, and looks after each at what it left."""

    def run(self, state: Any) -> None:
        """numba's; see there."""
        for each, _ in self.passes:
            one = _pass_registry.get(each).pass_inst
            one.analysis = self._analysis
            one.run_initialization(state)
            one.run_pass(state)
            one.run_finalizer(state)


class _Interpreter(Interpreter):
    """Hot functions have no `with`, and build no lists and dictionaries for calls."""

    def post_process(self, peepholes: Any, func_ir: Any) -> Any:
        """Nothing to mend."""
        return func_ir


@register_pass(mutates_CFG=True, analysis_only=False)
class _Translating(TranslateByteCode):
    """numba's, by `_Interpreter`."""

    def run_pass(self, state: Any) -> bool:
        """numba's; see there."""
        state["func_ir"] = _Interpreter(state["func_id"]).interpret(state["bc"])
        return True


class _Lower(Lower):
    """Every array here is borrowed: nobody counts who holds it."""

    def incref(self, typ: Any, val: Any) -> None:
        """Nothing."""

    def decref(self, typ: Any, val: Any) -> None:
        """Nothing."""

    _disable_sroa_like_opt = False
    """Asked for each variable that is read or written; nothing here is debugged."""

    def lower_block(self, block: Any) -> None:
        """numba's, which prepares for each statement what it would say of an error."""
        self.pre_block(block)
        for inst in block.body:
            self.loc = inst.loc
            try:
                self.lower_inst(inst)
            except Exception:
                with _errors.new_error_context(
                    'lowering "{inst}" at {loc}', inst=inst, loc=inst.loc, errcls_=LoweringError
                ):
                    raise
        self.post_block(block)

    def lower_binop(self, resty: Any, expr: Any, op: Any) -> Any:
        """numba's, which tries three times for operands that are known, when none is."""
        if expr.static_lhs is not ir.UNDEFINED or expr.static_rhs is not ir.UNDEFINED:
            return super().lower_binop(resty, expr, op)
        context, builder, signature = self.context, self.builder, self.fndesc.calltypes[expr]
        function = context.typing_context.resolve_value_type(op)
        operands = [
            context.cast(builder, self.loadvar(v.name), self.typeof(v.name), kind)
            for v, kind in zip((expr.lhs, expr.rhs), signature.args, strict=True)
        ]
        chosen = function.get_call_type(context.typing_context, signature.args, {})
        result = context.get_function(function, chosen)(builder, operands)
        return context.cast(builder, result, signature.return_type, resty)


@register_pass(mutates_CFG=True, analysis_only=False)
class _Lowering(NativeLowering):
    """numba's, by `_Lower`."""

    @property
    def lowering_class(self) -> type[Lower]:
        """See there."""
        return _Lower


class _Pipeline(CompilerBase):
    """Of numba's passes those that hot functions need: no closures, generators, literals to unroll, inlined overloads, array
    expressions, annotations; nothing that says where a variable ends, since nobody counts."""

    def define_pipelines(self) -> list[Any]:
        passes = _Passes("hot")
        for each in (
            _Translating, FixupArgs, IRProcessing, GenericRewrites, ReconstructSSA,
            NopythonTypeInference, PreLowerStripPhis, _Lowering, NoPythonBackend,
        ):  # fmt: skip
            passes.add_pass(each, each.__name__)
        passes.finalize()
        return [passes]


class _Hot(CPUDispatcher):
    """Callers that say f(1) and f(2) share the code for a whole number: numba would make one for each."""

    def get_call_template(self, args: Any, kws: Any) -> Any:
        return super().get_call_template(
            tuple(map(types.unliteral, args)), {k: types.unliteral(v) for k, v in kws.items()}
        )


def hot(function: Callable) -> Any:
    """numba's form of a hot function. No fastmath: the same input gives the same bits."""
    return _Hot(function, targetoptions=dict(_OPTIONS), pipeline_class=_Pipeline)
