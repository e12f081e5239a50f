# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which code decides an answer: the source files behind a module, and one digest of them.

A figure is older than the code that it measures, and a kept answer is one of older code, where
`digest_of(import_closure(modules))` is no longer what it was.

The closure holds every source file of this package that the modules import, directly or not, at
their top or within functions, with the `__init__.py` of the packages on the way. It follows
`importlib.import_module` where the name is written out, and takes all modules of a package where
only the package is: `f"{effects.__name__}.{name}"`, `f"dotsim_ros.baselines.{name}"`. It leaves out
what is imported under `if TYPE_CHECKING:`, and `dotsim_ros/__init__.py`, which only says where
names live: a name that is taken from there leads to the module that its table gives.

The digest covers what is left of the files' syntax trees: definitions, constants, defaults,
annotations and messages, in their order within a file, and for each name that a file imports what
the file that it comes from holds. It does not cover comments, layout, docstrings and other strings
that stand alone, `__all__`, what stands under `if TYPE_CHECKING:`, nor the names and the places of
the files. So a module that moves changes nothing, nor do the imports that follow it; a definition
that moves from one file to another does.

Neither covers what is no Python source of this package: other libraries and their versions, data
files such as sensors and weights, and programs that are started as processes of their own.
"""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path, PurePosixPath
from typing import Any

PACKAGES = ("dotsim_ros", "msg_adapters")
_FRONT_DOOR = "dotsim_ros"
_EVERY_MODULE = "**"
_FOR_ANNOTATIONS = frozenset({"__future__", "typing", "collections.abc"})
_NO_MEANING = frozenset({"ctx", "kind", "type_comment"})
_INIT = "__init__.py"


class FolderSources(Mapping[str, bytes]):
    """The Python files of the packages in a folder, and scripts beside them.

    They are listed at once and read when asked for.

    Args:
        root: folder that holds the packages: a checkout, or where packages are installed.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        # Asked for thousands of times: names that are not there are most of them.
        self._modules = {
            path.relative_to(root).as_posix(): path
            for package in PACKAGES
            for path in sorted((root / package).rglob("*.py"))
        }

    def __getitem__(self, path: str) -> bytes:
        if path not in self:
            raise KeyError(path)
        return (self.root / path).read_bytes()

    def __contains__(self, path: object) -> bool:
        if path in self._modules:
            return True
        is_script = isinstance(path, str) and path.partition("/")[0] not in PACKAGES
        return is_script and (self.root / str(path)).is_file()

    def __iter__(self) -> Iterator[str]:
        return iter(self._modules)

    def __len__(self) -> int:
        return len(self._modules)


@cache
def version_of(*modules: str) -> str:
    """Return the digest of all code that modules of this package run, as it was when first asked.

    Args:
        modules: names, such as "dotsim_ros.gel.implicit".

    Raises:
        FileNotFoundError: as `import_closure`.
    """
    return digest_of(import_closure(modules))


def import_closure(
    roots: Iterable[str], sources: Mapping[str, bytes] | None = None
) -> tuple[str, ...]:
    """Return the source files that modules or scripts are made of, theirs included.

    Args:
        roots: names of modules, such as "dotsim_ros.sensor", and paths of scripts, such as
            "benchmarks/soak.py".
        sources: Python files by their path, with "/", from the folder that holds the packages;
            those of the package that runs where left out.

    Returns:
        Paths as in `sources`, sorted.

    Raises:
        FileNotFoundError: the source of a root, or of what one imports, is not there.
        ValueError: a file is not Python.
    """
    sources = _installed() if sources is None else sources
    found: set[str] = set()
    waiting: list[str] = []
    for root in roots:
        if root.endswith(".py"):
            if root not in sources:
                raise FileNotFoundError(f"no script {root}; expected one such as benchmarks/x.py")
            waiting.append(root)
        else:
            waiting += _files_of(_Import(root), "", sources)
    while waiting:
        path = waiting.pop()
        if path not in found:
            found.add(path)
            for imported in _parsed(path, sources).imports:
                waiting += _files_of(imported, path, sources)
    return tuple(sorted(found))


def digest_of(files: Iterable[str], sources: Mapping[str, bytes] | None = None) -> str:
    """Return a digest of what files do; the module's docstring says what it covers.

    Args:
        files: paths as `import_closure` gives them.
        sources: as for `import_closure`.

    Returns:
        64 hexadecimal digits.

    Raises:
        FileNotFoundError: a file, or what one imports, is not there.
        ValueError: a file is not Python.
    """
    sources = _installed() if sources is None else sources
    held = {path: _parsed(path, sources) for path in files}
    parts = []
    for path, parsed in held.items():
        if parsed.is_empty:
            continue
        # A name that is taken from another file than before is another name.
        taken = sorted(
            f"{imported.name} {imported.bound} {_origin(imported, path, held, sources)}"
            for imported in parsed.imports
            if imported.module not in _FOR_ANNOTATIONS
        )
        parts.append(_hash("\n".join([parsed.digest, *taken])))
    return _hash("\n".join(sorted(parts)))


@dataclass(frozen=True)
class _Import:
    """A module, or a name from one.

    Attributes:
        module: where it comes from, without leading dots.
        name: of what is taken from it; None for the module itself, `_EVERY_MODULE` for all
            modules of a package.
        bound: the name that it gets, where it is another.
        level: the number of leading dots.
    """

    module: str
    name: str | None = None
    bound: str | None = None
    level: int = 0


@dataclass(frozen=True)
class _Parsed:
    digest: str
    is_empty: bool
    imports: frozenset[_Import]


@cache
def _installed() -> FolderSources:
    return FolderSources(Path(__file__).parent.parent)


def _hash(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _parsed(path: str, sources: Mapping[str, bytes]) -> _Parsed:
    try:
        source = sources[path]
    except KeyError:
        raise FileNotFoundError(
            f"the source file {path} is not there; the version of the code is that of its sources: "
            "install the package with its .py files"
        ) from None
    try:
        return _parse(source)
    except (SyntaxError, ValueError) as error:
        raise ValueError(f"{path} cannot be read as Python: {error}") from error


# By content: versions of one file, and copies of it, are parsed once each.
@lru_cache(maxsize=4096)
def _parse(source: bytes) -> _Parsed:
    tree = ast.parse(source)
    imports: list[_Import] = []
    calls: list[ast.Call] = []
    text = _flatten(tree.body, imports, calls)
    packages = {
        imported.bound or imported.name: f"{imported.module}.{imported.name}"
        for imported in imports
        if imported.name is not None and not imported.level
    }
    for call in calls:
        imports += _imported_by_call(call, packages)
    front_doors = {i.bound or i.module for i in imports if i == _Import(_FRONT_DOOR, None, i.bound)}
    if front_doors:
        imports += [
            _Import(_FRONT_DOOR, node.attr)
            for node in ast.walk(tree)
            if isinstance(node, ast.Attribute)
            and isinstance(node.value, ast.Name)
            and node.value.id in front_doors
            and not node.attr.startswith("__")
        ]
    return _Parsed(_hash(text), text == "[0", frozenset(imports))


_FIELDS: dict[type, tuple[str, ...]] = {}


def _flatten(body: list[ast.stmt], imports: list[_Import], calls: list[ast.Call]) -> str:
    """Return statements as text that two trees share only if they do the same.

    Fields that are empty are left out, so that Python 3.11 and 3.12 give the same.

    Args:
        body: the statements.
        imports: gets every import statement's names.
        calls: gets every call of `import_module`.
    """
    out: list[str] = []
    waiting: list[Any] = [body]
    while waiting:
        item = waiting.pop()
        kind = item.__class__
        if kind is list:
            if item and isinstance(item[0], ast.stmt):
                item = _that_count(item, imports)
            out.append(f"[{len(item)}")
            waiting += item
            continue
        fields = _FIELDS.get(kind)
        if fields is None:
            if not isinstance(item, ast.AST):
                out.append(repr(item))
                continue
            fields = tuple(name for name in kind._fields if name not in _NO_MEANING)
            _FIELDS[kind] = fields
        if kind is ast.Call and _name_of(item.func) == "import_module":
            calls.append(item)
        out.append(kind.__name__)
        values = item.__dict__
        for name in fields:
            value = values.get(name)
            if value is not None and (value or value.__class__ is not list):
                out.append(name)
                waiting.append(value)
    return " ".join(out)


def _that_count(body: list[ast.stmt], imports: list[_Import]) -> list[ast.stmt]:
    """Return the statements of a block that do something here; its imports go to `imports`."""
    kept: list[ast.stmt] = []
    for statement in body:
        match statement:
            case ast.Import(names):
                imports += [_Import(alias.name, None, alias.asname) for alias in names]
            case ast.ImportFrom(module, names, level):
                imports += [
                    _Import(module or "", alias.name, alias.asname, level) for alias in names
                ]
            case ast.Expr(ast.Constant(str())):
                pass
            case ast.If(test, _, otherwise) if _name_of(test) == "TYPE_CHECKING":
                kept += _that_count(otherwise, imports)
            case ast.Assign([ast.Name("__all__")]):
                pass
            case _:
                kept.append(statement)
    return kept


def _name_of(expression: ast.expr) -> str | None:
    match expression:
        case ast.Name(name) | ast.Attribute(_, name):
            return name
    return None


def _imported_by_call(call: ast.Call, packages: Mapping[str, str]) -> list[_Import]:
    """Return what `import_module` imports, as far as its argument is written out.

    Args:
        call: of `import_module`.
        packages: full names of what the file imports from packages, by the name in the file.
    """
    match call.args:
        case [ast.Constant(str(name)), *_]:
            return [_Import(name)]
        case [ast.JoinedStr([ast.Constant(str(start)), *_]), *_] if "." in start:
            return [_Import(start.rpartition(".")[0], _EVERY_MODULE)]
        case [
            ast.JoinedStr([ast.FormattedValue(ast.Attribute(ast.Name(name), "__name__")), *_]),
            *_,
        ] if name in packages:
            return [_Import(packages[name], _EVERY_MODULE)]
    return []


def _files_of(imported: _Import, importer: str, sources: Mapping[str, bytes]) -> list[str]:
    """Return the files of this package that an import runs, those of the packages on the way too.

    Raises:
        FileNotFoundError: it is of this package and has no source.
    """
    module = _absolute(imported, importer)
    top = module.partition(".")[0]
    if top not in PACKAGES:
        # A script may import another that lies beside it.
        beside = PurePosixPath(importer).parent / f"{top}.py"
        is_script = importer.partition("/")[0] not in PACKAGES
        return [str(beside)] if is_script and str(beside) in sources else []
    home = _file_of(module, sources)
    if imported.name == _EVERY_MODULE:
        folder = PurePosixPath(module.replace(".", "/"))
        every = [path for path in sources if PurePosixPath(path).parent == folder]
        return [*_on_the_way(module, sources), *every]
    if imported.name is not None:
        inner = f"{module}.{imported.name}"
        if _file_of(inner, sources) is not None:
            return _on_the_way(inner, sources)
        if home is not None and home.endswith(_INIT):
            named = _named_by_table(sources[home], module, imported.name, sources)
            if named is not None:
                return [*_on_the_way(module, sources), *_on_the_way(named, sources)]
            if module == _FRONT_DOOR and not imported.name.startswith("__"):
                raise FileNotFoundError(
                    f"{importer} takes {imported.name} from {module}; expected a module, or a name "
                    f"in a dictionary of {home} that is written out and says which module it is in"
                )
    if home is None:
        asked = f"{importer} imports {module}" if importer else f"{module} is asked for"
        raise FileNotFoundError(
            f"{asked}, whose source is not there; correct the name, or install the package with "
            "its .py files"
        )
    return _on_the_way(module, sources)


def _absolute(imported: _Import, importer: str) -> str:
    if not imported.level:
        return imported.module
    folder = PurePosixPath(importer).parent.parts
    package = folder[: len(folder) - imported.level + 1]
    return ".".join([*package, *filter(None, [imported.module])])


def _file_of(module: str, sources: Mapping[str, bytes]) -> str | None:
    stem = module.replace(".", "/")
    return next((path for path in (f"{stem}.py", f"{stem}/{_INIT}") if path in sources), None)


def _on_the_way(module: str, sources: Mapping[str, bytes]) -> list[str]:
    parts = module.split(".")
    names = [".".join(parts[: count + 1]) for count in range(len(parts))]
    files = [_file_of(name, sources) for name in names if name != _FRONT_DOOR]
    return [path for path in files if path is not None]


def _named_by_table(
    source: bytes, package: str, name: str, sources: Mapping[str, bytes]
) -> str | None:
    """Return the module that a package's own table gives for a name that it loads when asked.

    A table is a dictionary that is written out, of names to modules or of modules to names.
    """
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Dict):
            for key, value in zip(node.keys, node.values, strict=True):
                sides = [_strings(side) for side in (key, value)]
                for names, modules in (sides, sides[::-1]):
                    if name in names:
                        for module in modules:
                            full = package + module if module.startswith(".") else module
                            if full.partition(".")[0] in PACKAGES and _file_of(full, sources):
                                return full
    return None


def _strings(expression: ast.expr | None) -> list[str]:
    if expression is None:
        return []
    constants = [node for node in ast.walk(expression) if isinstance(node, ast.Constant)]
    return [node.value for node in constants if isinstance(node.value, str)]


def _origin(
    imported: _Import, importer: str, held: Mapping[str, _Parsed], sources: Mapping[str, bytes]
) -> str:
    """Return where an import comes from, in words that stay when this package's files move."""
    module = _absolute(imported, importer)
    if module.partition(".")[0] not in PACKAGES:
        return module
    files = _files_of(imported, importer, sources)
    return held[files[-1]].digest if files and files[-1] in held else ""
