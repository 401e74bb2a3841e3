# Builds an unchanged ament_cmake interface package against ROS 2 installed from PyPI.
#
# Pass it as CMAKE_PROJECT_INCLUDE; CMake then reads it right after `project()`. Both pip
# (pyproject.toml) and `make colcon` do. A full ROS 2 installation needs none of it.

# The folder the ROS 2 wheels are installed under: <prefix>/lib/pythonX.Y/site-packages/rosidl_adapter.
find_package(Python3 REQUIRED COMPONENTS Interpreter Development.Module)
execute_process(
  COMMAND "${Python3_EXECUTABLE}" -c
    "import pathlib, rosidl_adapter as r; print(pathlib.Path(r.__file__).parents[4])"
  OUTPUT_VARIABLE ros_prefix
  OUTPUT_STRIP_TRAILING_WHITESPACE
  COMMAND_ERROR_IS_FATAL ANY
)
list(PREPEND CMAKE_PREFIX_PATH "${ros_prefix}")
if(DEFINED ENV{AMENT_PREFIX_PATH})
  set(ENV{AMENT_PREFIX_PATH} "${ros_prefix}:$ENV{AMENT_PREFIX_PATH}")
else()
  set(ENV{AMENT_PREFIX_PATH} "${ros_prefix}")
endif()

if(SKBUILD)
  # Python modules into site-packages; libraries find each other and those of ROS 2
  # beside them, from <prefix>/lib as well as from <prefix>/lib/pythonX.Y/site-packages/<package>.
  set(PYTHON_INSTALL_DIR "${SKBUILD_PLATLIB_DIR}")
  set(CMAKE_INSTALL_RPATH "$ORIGIN;$ORIGIN/../../..")
  set(BUILD_TESTING OFF)
endif()

# The targets in the wheels name include folders of the machine they were built on (Python's, for one).
# CMake refuses a target whose include folder does not exist, so those are dropped.
function(drop_missing_include_directories)
  get_property(targets DIRECTORY PROPERTY IMPORTED_TARGETS)
  foreach(target IN LISTS targets)
    get_target_property(directories "${target}" INTERFACE_INCLUDE_DIRECTORIES)
    if(NOT directories)
      continue()
    endif()
    set(existing)
    foreach(directory IN LISTS directories)
      if(directory MATCHES "\\$<" OR EXISTS "${directory}")
        list(APPEND existing "${directory}")
      endif()
    endforeach()
    set_target_properties("${target}" PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${existing}")
  endforeach()
endfunction()
cmake_language(DEFER CALL drop_missing_include_directories)
