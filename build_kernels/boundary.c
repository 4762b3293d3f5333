/* Copyright 2026 The rigid_body_ros developers

   Licensed under the Apache License, Version 2.0 (the "License");
   you may not use this file except in compliance with the License.
   You may obtain a copy of the License at

       http://www.apache.org/licenses/LICENSE-2.0

   Unless required by applicable law or agreed to in writing, software
   distributed under the License is distributed on an "AS IS" BASIS,
   WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
   See the License for the specific language governing permissions and
   limitations under the License. */

/* The boundary between Python and the compiled kernels: checks the arguments, takes arrays and
   numbers out of Python's objects, releases the GIL, and calls a kernel. table.h is generated. */

#define PY_SSIZE_T_CLEAN
#define NPY_NO_DEPRECATED_API NPY_1_7_API_VERSION
#include <Python.h>
#include <numpy/arrayobject.h>
#include <math.h>
#include <stdint.h>
#include <string.h>

/* Of the variables in dimensions, the last is the number of lanes. */
enum { DIMENSIONS = 4, LEAVES = 32, VARIABLES = 27, RESULTS = 4, LEVELS = 3 };

/* A leaf of the arguments, as a kernel takes it. A number is in shape[0]. */
typedef struct { void *data; int64_t shape[DIMENSIONS]; } slot;
typedef int32_t kernel(int64_t *, const slot *);
/* factor times a variable (index; -1: none) plus offset; `other` is allowed, too. */
typedef struct { int factor, variable, offset, other; } dimension;
/* See signatures.py. `count`: dimensions of an array, parts of a tuple. */
typedef struct {
  char kind, count, is_written;
  int size;
  dimension dimensions[DIMENSIONS];
  const char *label, *expected;
} part;
typedef struct { const part *parts; kernel *const calls[LEVELS]; } signature;
typedef struct {
  const char *name, *results;
  int arguments, count;
  const signature *signatures;
} entry;
#include "table.h"
enum { ENTRIES = sizeof entries / sizeof *entries, LEVEL_COUNT = sizeof levels / sizeof *levels };

/* A kernel at a level, as Python calls it. */
typedef struct { const entry *entry; int level; PyMethodDef definition; } callable;

/* The mismatch of the signature whose arguments fit furthest; None is what is expected last. */
typedef struct { PyObject *kind; const part *expected; PyObject *found; int reached; } mismatch;

typedef struct {
  const part *next;
  slot *slot;
  int64_t variables[VARIABLES];
  mismatch *mismatch;
} reader;

static int fail(reader *r, PyObject *kind, const part *p, PyObject *found, int reached) {
  if (reached > r->mismatch->reached || (reached == r->mismatch->reached && p->kind != '-'))
    *r->mismatch = (mismatch){kind, p, found, reached};
  return 0;
}

static int fits_dimension(const dimension *d, int64_t size, int64_t *variables) {
  if (size == d->other) return 1;
  if (d->variable < 0) return size == d->offset;
  if (variables[d->variable] < 0) {
    int64_t rest = size - d->offset;
    if (rest < 0 || rest % d->factor) return 0;
    variables[d->variable] = rest / d->factor;
  }
  return size == d->factor * variables[d->variable] + d->offset;
}

static int read_array(reader *r, const part *p, PyObject *object, int reached) {
  PyArrayObject *a = (PyArrayObject *)object;
  if (!PyArray_Check(object) || PyArray_DESCR(a)->kind != p->kind
      || PyArray_ITEMSIZE(a) != p->size || PyArray_NDIM(a) != p->count
      || !PyArray_ISCARRAY_RO(a) || (p->is_written && !PyArray_ISWRITEABLE(a)))
    return fail(r, PyExc_TypeError, p, object, reached);
  r->slot->data = PyArray_DATA(a);
  for (int k = 0; k < p->count; k++) {
    r->slot->shape[k] = PyArray_DIM(a, k);
    if (!fits_dimension(&p->dimensions[k], PyArray_DIM(a, k), r->variables))
      return fail(r, PyExc_ValueError, p, object, reached);
  }
  r->slot++;
  return 1;
}

static int read_number(reader *r, const part *p, PyObject *object, int reached) {
  double number;
  int64_t bits = 0;
  if (p->kind == 'F') {
    number = PyFloat_AsDouble(object);
    memcpy(&bits, &number, sizeof bits);
  } else if (p->kind == 'B' && (PyBool_Check(object) || PyArray_IsScalar(object, Bool))) {
    bits = PyObject_IsTrue(object);
  } else if (p->kind == 'I' && PyIndex_Check(object)) {
    PyObject *integer = PyNumber_Index(object);
    bits = integer ? PyLong_AsLongLong(integer) : 0;
    Py_XDECREF(integer);
  } else {
    return fail(r, PyExc_TypeError, p, object, reached);
  }
  if (PyErr_Occurred()) {
    PyErr_Clear();
    return fail(r, PyExc_TypeError, p, object, reached);
  }
  (r->slot++)->shape[0] = bits;
  return 1;
}

static int read_part(reader *r, PyObject *object, int *reached) {
  const part *p = r->next++;
  int place = (*reached)++;
  switch (p->kind) {
    case '-': return object == Py_None || fail(r, PyExc_TypeError, p, object, place);
    case 'I': case 'F': case 'B': return read_number(r, p, object, place);
    case '(':
      if (!PyTuple_Check(object) || PyTuple_GET_SIZE(object) != p->count)
        return fail(r, PyExc_TypeError, p, object, place);
      for (int k = 0; k < p->count; k++)
        if (!read_part(r, PyTuple_GET_ITEM(object, k), reached)) return 0;
      return 1;
    default: return read_array(r, p, object, place);
  }
}

static PyObject *result(char kind, int64_t bits) {
  double number;
  memcpy(&number, &bits, sizeof number);
  switch (kind) {
    case 'I': return PyLong_FromLongLong(bits);
    case 'B': return PyBool_FromLong((long)(bits & 1));
    case 'F': return PyFloat_FromDouble(number);
    default: Py_RETURN_NONE;
  }
}

static PyObject *run(const entry *e, kernel *call, const slot *slots) {
  int64_t bits[RESULTS] = {0};
  int32_t status;
  Py_BEGIN_ALLOW_THREADS
  status = call(bits, slots);
  Py_END_ALLOW_THREADS
  if (status) return PyErr_Format(PyExc_RuntimeError, "%s: the kernel failed", e->name);
  Py_ssize_t count = (Py_ssize_t)strlen(e->results);
  if (count == 1) return result(e->results[0], bits[0]);
  PyObject *all = PyTuple_New(count);
  for (Py_ssize_t k = 0; all && k < count; k++) {
    PyObject *one = result(e->results[k], bits[k]);
    if (!one) { Py_CLEAR(all); break; }
    PyTuple_SET_ITEM(all, k, one);
  }
  return all;
}

static PyObject *describe(PyObject *found) {
  if (!PyArray_Check(found)) return PyUnicode_FromString(Py_TYPE(found)->tp_name);
  PyArrayObject *a = (PyArrayObject *)found;
  PyObject *shape = PyObject_GetAttrString(found, "shape");
  PyObject *text = PyUnicode_FromFormat(
      "%S %S%s%s", (PyObject *)PyArray_DESCR(a), shape,
      PyArray_ISCARRAY_RO(a) ? "" : ", not contiguous", PyArray_ISWRITEABLE(a) ? "" : ", read-only");
  Py_XDECREF(shape);
  return text;
}

static PyObject *call(PyObject *self, PyObject *const *arguments, Py_ssize_t count) {
  const callable *called = PyCapsule_GetPointer(self, NULL);
  if (!called) return NULL;
  const entry *e = called->entry;
  if (count != e->arguments)
    return PyErr_Format(PyExc_TypeError, "%s: expected %d arguments, found %zd", e->name,
                        e->arguments, count);
  mismatch worst = {.reached = -1};
  for (int j = 0; j < e->count; j++) {
    slot slots[LEAVES];
    reader r = {e->signatures[j].parts, slots, {0}, &worst};
    memset(r.variables, -1, sizeof r.variables);
    r.variables[VARIABLES - 1] = levels[called->level].lanes;
    int reached = 0;
    Py_ssize_t k = 0;
    while (k < count && read_part(&r, arguments[k], &reached)) k++;
    if (k == count) return run(e, e->signatures[j].calls[called->level], slots);
  }
  PyObject *found = describe(worst.found);
  if (found)
    PyErr_Format(worst.kind, "%s: expected %s: %s%s, found %U", e->name, worst.expected->label,
                 worst.expected->expected, worst.expected->is_written ? ", writable" : "", found);
  Py_XDECREF(found);
  return NULL;
}

static int has_level(const char *level) {
#ifdef __x86_64__
  __builtin_cpu_init();  /* with what the operating system saves of the registers */
  if (!strcmp(level, "x86-64-v4"))
    return has_level("x86-64-v3") && __builtin_cpu_supports("avx512f")
        && __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512dq")
        && __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512cd");
  if (!strcmp(level, "x86-64-v3"))
    return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")
        && __builtin_cpu_supports("bmi") && __builtin_cpu_supports("bmi2");
#endif
  (void)level;
  return 1;
}

static PyObject *kernels_of(PyObject *module, PyObject *level) {
  (void)module;
  static callable callables[LEVEL_COUNT][ENTRIES];
  const char *name = PyUnicode_AsUTF8(level);
  if (!name) return NULL;
  int place = 0;
  while (place < LEVEL_COUNT && strcmp(levels[place].name, name)) place++;
  if (place == LEVEL_COUNT || !has_level(name))
    return PyErr_Format(PyExc_ValueError, "this processor or module has no kernels for %U", level);
  PyObject *found = PyDict_New();
  for (int j = 0; found && j < ENTRIES; j++) {
    callable *one = &callables[place][j];
    *one = (callable){&entries[j], place, {
        entries[j].name, (PyCFunction)(void (*)(void))call, METH_FASTCALL, NULL}};
    PyObject *self = PyCapsule_New(one, NULL, NULL);
    PyObject *function = self ? PyCFunction_New(&one->definition, self) : NULL;
    Py_XDECREF(self);
    if (!function || PyDict_SetItemString(found, entries[j].name, function)) Py_CLEAR(found);
    Py_XDECREF(function);
  }
  return found;
}

static PyMethodDef functions[] = {
    {"kernels", kernels_of, METH_O, "Return the kernels by name, compiled for a processor level."},
    {0}};
static struct PyModuleDef module = {
    PyModuleDef_HEAD_INIT, "_compiled", "The compiled kernels.", -1, functions,
    NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__compiled(void) {
  import_array();
  PyObject *m = PyModule_Create(&module), *usable = PyTuple_New(0), *lanes = PyDict_New();
  for (int k = 0; m && usable && lanes && k < LEVEL_COUNT; k++) {
    PyObject *number = PyLong_FromLong(levels[k].lanes);
    if (!number || PyDict_SetItemString(lanes, levels[k].name, number)) Py_CLEAR(lanes);
    Py_XDECREF(number);
    if (has_level(levels[k].name)) {
      PyObject *one = Py_BuildValue("(s)", levels[k].name);
      PyObject *more = one ? PySequence_Concat(usable, one) : NULL;
      Py_XDECREF(one);
      Py_SETREF(usable, more);
    }
  }
  if (!m || !usable || !lanes || PyModule_AddStringConstant(m, "FILES", FILES)
      || PyModule_AddStringConstant(m, "SOURCES", SOURCES)
      || PyModule_AddObject(m, "LEVELS", usable) || PyModule_AddObject(m, "LANES", lanes)) {
    Py_XDECREF(m);
    return NULL;
  }
  return m;
}
