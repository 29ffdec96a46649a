// From TOML to sections: the only user of toml++.
#include "deck.h"

#define TOML_HEADER_ONLY 1
#define TOML_EXCEPTIONS 0
// toml++ 3.3 asserts what an invalid deck can violate, such as a line "[[", and with NDEBUG assumes
// it, which is undefined. Its own check after the assertion gives an error.
#undef NDEBUG
#define TOML_ASSERT(condition) static_cast<void>(0)
#include <toml++/toml.h>

namespace rk {

static Value convert(const toml::node &node) {
   Value value;
   if (const auto *text = node.as_string()) {
      value = Value(text->get());
   } else if (const auto *integer = node.as_integer()) {
      value = Value(integer->get());
   } else if (const auto *real = node.as_floating_point()) {
      value = Value(real->get());
   } else if (const auto *boolean = node.as_boolean()) {
      value.kind = Value::Kind::boolean;
      value.boolean = boolean->get();
   } else if (const auto *array = node.as_array()) {
      value.kind = Value::Kind::array;
      for (const toml::node &item : *array)
         value.items.push_back(convert(item));
   } else if (node.is_table()) {
      value.kind = Value::Kind::table;
   } else {
      value.kind = Value::Kind::date;
   }
   value.origin.line = static_cast<int>(node.source().begin.line);
   return value;
}

static Origin origin_of(const toml::key &key) {
   return {static_cast<int>(key.source().begin.line), 0, ""};
}

static void read_keys(Section &section, const toml::table &table) {
   for (const auto &[key, node] : table) {
      const std::string name(key.str());
      if (section.spec->find(name)) {
         section.values[name] = convert(node);
         section.values[name].origin = origin_of(key);
      } else {
         section.unknown.emplace_back(name, origin_of(key));
      }
   }
}

static void read_table(Deck &deck, const TableSpec &spec, const toml::key &key,
                       const toml::node &node) {
   const std::string one = "[" + spec.name + "]", many = "[[" + spec.name + "]]";
   const toml::array *array = node.as_array();
   // an array of tables given without any is an array too
   const bool tables =
       array && (array->is_array_of_tables() || (spec.many && array->empty()));
   auto add = [&](const toml::node &entry, int index) {
      Section section;
      section.spec = &spec;
      section.index = index;
      section.origin.line = static_cast<int>(entry.source().begin.line);
      read_keys(section, *entry.as_table());
      deck.sections.push_back(section);
   };
   if (tables != spec.many || !(tables || node.is_table()))
      deck.misshapen.insert(spec.name);
   if (spec.many && tables && array->size() > spec.most) {
      deck.misshapen.insert(spec.name);
      deck.complain(origin_of(key), spec.name,
                    "has " + std::to_string(array->size()) + " entries, but at most " +
                       std::to_string(spec.most) + " are allowed; merge equal ones");
   } else if (spec.many && tables) {
      int index = 0;
      for (const toml::node &entry : *array)
         add(entry, ++index);
   } else if (spec.many && node.is_table()) {
      deck.complain(origin_of(key), spec.name,
                    "is an array of tables: write " + many + " instead of " + one);
   } else if (!spec.many && node.is_table()) {
      add(node, 0);
   } else if (!spec.many && tables) {
      deck.complain(origin_of(key), spec.name,
                    "is a single table: write " + one + " instead of " + many);
   } else {
      deck.complain(origin_of(key), spec.name,
                    "must be a table " + (spec.many ? many : one) + ", not " +
                        convert(node).kind_name());
   }
}

bool read_toml(Deck &deck) {
   const toml::parse_result result = toml::parse(deck.text, deck.name);
   if (!result) {
      const toml::source_position place = result.error().source().begin;
      const std::string why(result.error().description());
      std::string cure;
      if (why.find("utf-8") != std::string::npos)
         cure = "; save the deck as UTF-8";
      else if (why.find("value type") != std::string::npos)
         cure = "; a text needs quotes, as in kind = \"box\"";
      else if (why.find("saw ','") != std::string::npos)
         cure = "; decimals have a point, lists brackets: 10.5, [10, 5]";
      deck.complain({static_cast<int>(place.line), static_cast<int>(place.column), ""}, "",
                    "not TOML: " + why + cure);
      return false;
   }
   const toml::table &root = result.table();
   const TableSpec &outside = schema().front();
   Section top;
   top.spec = &outside;
   deck.sections.push_back(top);
   for (const TableSpec &spec : schema()) {
      for (const auto &[key, node] : root) {
         if (!spec.name.empty() && key.str() == spec.name)
            read_table(deck, spec, key, node);
      }
   }
   for (const auto &[key, node] : root) {
      const std::string name(key.str());
      if (!name.empty() && find_table(name))
         continue;
      if (outside.find(name)) {
         deck.sections.front().values[name] = convert(node);
         deck.sections.front().values[name].origin = origin_of(key);
      } else if (node.is_table() || (node.as_array() && node.as_array()->is_array_of_tables())) {
         deck.complain(origin_of(key), name, unknown_table(name));
      } else {
         deck.complain(origin_of(key), name, unknown_key(outside, name));
      }
   }
   return true;
}

std::optional<Value> parse_value(const std::string &text) {
   const toml::parse_result result = toml::parse("value = " + text);
   if (!result || result.table().size() != 1)
      return std::nullopt;
   return convert(*result.table().get("value"));
}

} // namespace rk
