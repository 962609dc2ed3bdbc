#pragma once

#include <pybind11/pybind11.h>

#include <tuple>
#include <type_traits>
#include <utility>
#include <vector>

#include "numpy.hpp"
#include "python_types.hpp"

/// @file
/// Structs as tables of their members, with one line per member, from which bindings are made.
namespace manip3d::bindings {

/// A member of a struct and its name in Python.
template <typename T, typename Member>
struct Field {
  const char* name;
  Member T::* member;
};

template <typename T, typename Member>
Field(const char*, Member T::*) -> Field<T, Member>;

/// Converts a member to a Python object.
template <typename Member>
py::object to_object(Member&& value) {
  return py::cast(value);
}

/// Converts a matrix or vector to an array, which takes over its memory.
template <typename Member>
  requires requires { std::decay_t<Member>::ColsAtCompileTime; }
py::object to_object(Member&& value) {
  return to_numpy(std::move(value));
}

template <typename T>
py::object to_object(std::vector<T>&& values) {
  return to_numpy(std::move(values));
}

/// Moves the members of a result into a dict by name.
template <typename T, typename... Members>
Fields to_fields(T&& result, const std::tuple<Field<T, Members>...>& table) {
  static_assert(!std::is_reference_v<T>, "a result is given away");
  Fields fields;
  const auto put = [&](const auto& field) {
    fields[field.name] = to_object(std::move(result.*field.member));
  };
  std::apply([&](const auto&... each) { (put(each), ...); }, table);
  return fields;
}

/// Binds the members as attributes for reading and writing, and makes the class picklable.
template <typename T, typename... Members>
void bind_fields(py::class_<T>& bound, const std::tuple<Field<T, Members>...>& table) {
  const auto attribute = [&](const auto& field) { bound.def_readwrite(field.name, field.member); };
  std::apply([&](const auto&... each) { (attribute(each), ...); }, table);
  bound.def(py::pickle(
      [table](const T& value) {
        return std::apply(
            [&](const auto&... each) { return py::make_tuple(value.*each.member...); }, table);
      },
      [table](const py::tuple& state) {
        T value;
        std::size_t i = 0;
        const auto take = [&](const auto& field) {
          using Member = std::decay_t<decltype(value.*field.member)>;
          value.*field.member = state[i++].template cast<Member>();
        };
        std::apply([&](const auto&... each) { (take(each), ...); }, table);
        return value;
      }));
}

}  // namespace manip3d::bindings
