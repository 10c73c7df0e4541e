# The Python module with the types of a shared library, and the C table of its structs' sizes.
# tailbeat_add_binding(NAME HEADER [LAYOUT file.c] [INCLUDE folder...] [DEFINE name...] [DEPENDS file...])
# puts the path of _NAME_types.py into TAILBEAT_TYPES. cffi is needed only where no copy is carried.
set(TAILBEAT_TYPES "" CACHE INTERNAL "")

function(tailbeat_add_binding name header)
  cmake_parse_arguments(PARSE_ARGV 2 arg "" "LAYOUT" "INCLUDE;DEFINE;DEPENDS")
  set(module ${CMAKE_CURRENT_BINARY_DIR}/_${name}_types.py)
  set(TAILBEAT_TYPES ${TAILBEAT_TYPES} ${module} CACHE INTERNAL "")
  if(EXISTS ${TAILBEAT_CARRIED}/binding/_${name}_types.py)
    file(COPY_FILE ${TAILBEAT_CARRIED}/binding/_${name}_types.py ${module} ONLY_IF_DIFFERENT)
    if(arg_LAYOUT)
      cmake_path(GET arg_LAYOUT FILENAME layout)
      file(COPY_FILE ${TAILBEAT_CARRIED}/binding/${layout} ${arg_LAYOUT} ONLY_IF_DIFFERENT)
    endif()
    return()
  endif()
  set(script ${PROJECT_SOURCE_DIR}/host/native/make_binding.py)
  set(command ${Python_EXECUTABLE} ${script} --compiler ${CMAKE_C_COMPILER}
    --header ${CMAKE_CURRENT_SOURCE_DIR}/${header} --module ${module})
  list(TRANSFORM arg_DEFINE PREPEND --define=)
  list(TRANSFORM arg_INCLUDE PREPEND --include=)
  if(arg_LAYOUT)
    list(APPEND command --layout ${arg_LAYOUT})
  endif()
  add_custom_command(
    OUTPUT ${module} ${arg_LAYOUT}
    COMMAND ${command} --include=${PROJECT_SOURCE_DIR}/host/native/cffi_headers ${arg_INCLUDE} ${arg_DEFINE}
    DEPENDS ${script} ${header} ${arg_DEPENDS}
    COMMENT "Writing the types for cffi (${name})"
    VERBATIM)
  add_custom_target(binding_${name} DEPENDS ${module} ${arg_LAYOUT})
endfunction()

# For a shared library that Python loads: the same name everywhere, and no symbol from elsewhere.
function(tailbeat_loaded_by_python target)
  set_target_properties(${target} PROPERTIES PREFIX lib WINDOWS_EXPORT_ALL_SYMBOLS ON)
  if(NOT (APPLE OR WIN32))
    target_link_options(${target} PRIVATE -Wl,-Bsymbolic)
    if(NOT TAILBEAT_SANITIZE)
      target_link_options(${target} PRIVATE -Wl,--no-undefined)
    endif()
  endif()
endfunction()
