// Expressions in coordinates, as decks hold them: numbers, names, arithmetic, comparisons and the
// functions of muParser; nothing that could act on anything.
#pragma once

#include <string>
#include <vector>

namespace rk {

// Names of the values that an expression may be asked for, in the order in which they come
const std::vector<std::string> &expression_names();

// Why a text is not an expression in these names and functions of one value, with the place of the
// mistake; "" where it is one
std::string expression_fault(const std::string &text, const std::vector<std::string> &names,
                             const std::vector<std::string> &tables = {});

// Why a word cannot name a table; "" where it can
std::string table_name_fault(const std::string &name);

// Whether a name occurs in an expression
bool expression_uses(const std::string &text, const std::string &name);

} // namespace rk
