"""LLVM libraries of kernels: how much of a kernel is compiled, and what is cached of it. core/kernel.py imports it late."""

from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

from llvmlite import binding
from numba import version_info
from numba.core.codegen import JITCodeLibrary
from numba.core.targetconfig import TargetConfig

TRIED = (0, 68)  # others may have other passes, and compile in numba's own way


class KernelLibrary(JITCodeLibrary):
    """Library of a kernel, or of a function that a kernel calls.

    Numba optimises and translates every function by itself and then again as a part of each caller. Here only a kernel that
    Python calls is: the functions that it calls are tidied and linked into it. The code that nothing ran took a sixth of a first
    run. Cached are the machine code of a kernel that Python calls, and the LLVM code of any other.
    """

    called = ""  # qualified name of the kernel that Python calls and that is being compiled

    # Any: numba's codegen has no types.
    def __init__(self, codegen: Any, name: str) -> None:
        super().__init__(codegen, name)
        self.runs = name == KernelLibrary.called

    @property
    def codegen(self) -> Any:
        """Numba's codegen; of a function that is only linked, one that does not set its environment, which has no address."""
        return super().codegen if self.runs else SimpleNamespace(set_env=lambda name, environment: None)

    def finalize(self) -> None:
        """Link the libraries of the functions that this one calls; of a kernel that Python calls, also compile the result."""
        if self.runs:
            super().finalize()
            return
        self._raise_if_finalized()
        for library in dict.fromkeys(self._linking_libraries):
            self._reload_init.update(library._reload_init)
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._keep(self._final_module)

    def _keep(self, module):
        self._final_module, self._finalized = module, True
        self._finalize_dynamic_globals()

    def _optimize_functions(self, ll_module):
        """Tidies a module as it was lowered: a third of the code remains, and none of the addresses that nothing reads."""
        ll_module.data_layout = self._codegen._data_layout
        builder, passes = self._codegen._pass_builder(), binding.create_new_module_pass_manager()
        passes.add_sroa_pass()
        passes.add_simplify_cfg_pass()
        passes.add_dead_code_elimination_pass()
        passes.add_global_dead_code_eliminate_pass()
        passes.run(ll_module, builder)

    def serialize_using_object_code(self) -> tuple:
        """Return (name, kind, data), which numba pickles: machine code and the names that it defines, or LLVM code."""
        self._ensure_finalized()
        if not self.runs:
            return self.name, "linked", self._get_module_for_linking().as_bitcode()
        module = self._final_module
        names = [v.name for values in (module.functions, module.global_variables) for v in values if not v.is_declaration]
        return self.name, "runs", (self._get_compiled_object(), names)

    @classmethod
    def _unserialize(cls, codegen, state):
        name, kind, data = state
        library = cls(codegen, name)
        library.runs = kind == "runs"
        if not library.runs:
            library._keep(binding.parse_bitcode(data))
            return library
        code, names = data
        library.enable_object_caching()
        library._set_compiled_object(code)
        library._finalize_final_module()
        codegen._engine._defined_symbols.update(names)
        return library


@contextmanager
def kernel_libraries(codegen: Any, called: str) -> Iterator[None]:
    """Context manager: codegen makes a KernelLibrary of every function, if numba has the version TRIED. called:
    qualified name of the function that Python calls, "" for none."""
    if version_info.short != TRIED:
        yield
        return
    before = codegen._library_class, KernelLibrary.called
    codegen._library_class, KernelLibrary.called = KernelLibrary, called
    try:
        yield
    finally:
        codegen._library_class, KernelLibrary.called = before


def _values(self):
    kind = type(self)
    if kind not in _DEFAULTS:
        _DEFAULTS[kind] = {name: option.default for name, option in kind.options.items()}
    return {**_DEFAULTS[kind], **self._values}


# Numba compares settings at each operator it types, a fifth of its time, and reads each of them through a property.
_DEFAULTS: dict[type, dict[str, Any]] = {}
if version_info.short == TRIED:
    TargetConfig.values = _values  # type: ignore[method-assign]
