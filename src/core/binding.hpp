// What all files of bindings share: arrays in and out. Sizes and types are checked here and nowhere else.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/unique_ptr.h>
#include <nanobind/stl/vector.h>

#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "arrays.hpp"
#include "image.hpp"

namespace nb = nanobind;
using namespace nb::literals;

template <class T, std::size_t N>
using Array = nb::ndarray<const T, nb::ndim<N>, nb::c_contig, nb::device::cpu>;
template <class T>
using Image = nb::ndarray<const T, nb::shape<-1, -1, 3>, nb::device::cpu>;  // of any strides

// Releases Python's lock while it lives. Python ends a thread that asks for the lock while Python itself ends, and in
// the midst of C++ that aborts the process (before Python 3.14). So such a thread waits for the end, without the lock.
class Unlocked {
  public:
    Unlocked();
    ~Unlocked();
    Unlocked(const Unlocked&) = delete;
    Unlocked& operator=(const Unlocked&) = delete;
    static bool ending();  // whether Python ends, so that no other thread may ask for the lock any more
    static void end();     // for atexit: waits for the threads that run without the lock

  private:
    PyThreadState* state_;
};

inline void require(bool holds, const char* fault) {
    if (!holds) throw std::invalid_argument(fault);
}

// A NumPy array of the given shape that owns the numbers.
template <class T>
nb::object owned(std::vector<T>&& numbers, std::initializer_list<std::size_t> shape) {
    auto* kept = new std::vector<T>(std::move(numbers));
    nb::capsule owner(kept, [](void* each) noexcept { delete static_cast<std::vector<T>*>(each); });
    const nb::ndarray<nb::numpy, T> array(kept->data(), shape, owner);
    return nb::cast(array, nb::rv_policy::reference);  // another policy would copy
}
template <class T>
nb::object copied(const std::vector<T>& numbers, std::initializer_list<std::size_t> shape) {
    return owned(std::vector<T>(numbers), shape);
}
inline nb::object copied(const liaam::Matrix& matrix) {
    return copied(matrix.numbers(), {matrix.rows(), matrix.columns()});
}

template <class T>
std::span<const T> span_of(const Array<T, 1>& array) {
    return {array.data(), array.shape(0)};
}
template <class T>
liaam::Rows<const T> rows_of(const Array<T, 2>& array) {
    return {array.data(), array.shape(0), array.shape(1)};
}
inline liaam::Matrix matrix_of(const Array<double, 2>& array) {
    liaam::Matrix matrix(array.shape(0), array.shape(1));
    std::copy(array.data(), array.data() + array.size(), matrix.numbers().begin());
    return matrix;
}

template <class T>
liaam::Stored<T> stored(const Image<T>& image) {
    return {image.data(), static_cast<std::ptrdiff_t>(image.shape(0)), static_cast<std::ptrdiff_t>(image.shape(1)),
            image.stride(0), image.stride(1), image.stride(2)};
}

void bind_level(nb::module_& module);
void bind_fit(nb::module_& module);
void bind_images(nb::module_& module);
void bind_parts(nb::module_& module);
