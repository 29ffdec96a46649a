// Overrides "table.key=value", as given by --set on the command line.
#include "deck.h"

#include <regex>

namespace rk {

static std::string trim(const std::string &text) {
   const std::size_t first = text.find_first_not_of(" \t\r\n");
   if (first == std::string::npos)
      return "";
   return text.substr(first, text.find_last_not_of(" \t\r\n") - first + 1);
}

// Numbers such as .5 with the zero that TOML needs
static std::string with_zeros(const std::string &text) {
   return std::regex_replace(text, std::regex("(^|[^0-9])\\.([0-9])"), "$010.$2");
}

// A TOML value if it is one; a plain word, or anything for a key of type text, is kept verbatim
static Value read_value(const std::string &text, const KeySpec &key) {
   std::optional<Value> value = parse_value(text);
   const bool wants_text =
       key.type == Type::text && !(key.or_number && value && value->is_number());
   if (!value && key.type != Type::text)
      value = parse_value(with_zeros(text));
   if (value && (!wants_text || value->kind == Value::Kind::text))
      return *value;
   return Value(text);
}

// The section to which an override refers: a table of that name (added if the deck lacks it), the
// first entry of an array of tables, or the entry whose name (or number) is given in between
static Section *find_section(Deck &deck, const Origin &origin, const std::string &address,
                             const TableSpec &spec, const std::string &middle) {
   std::vector<Section *> entries = deck.entries(spec.name);
   if (!spec.many) {
      if (!middle.empty()) {
         deck.complain(origin, address,
                       "[" + spec.name + "] is a single table: write " + spec.name + ".key=value");
         return nullptr;
      }
      return entries.empty() ? &deck.add(spec, origin) : entries.front();
   }
   if (entries.empty()) {
      deck.complain(origin, address, "the deck has no [[" + spec.name + "]]");
      return nullptr;
   }
   if (middle.empty())
      return entries.front();
   std::vector<std::string> names;
   for (Section *entry : entries) {
      const std::string name = spec.named_by.empty() ? "" : entry->text(spec.named_by);
      if (name == middle)
         return entry;
      if (!name.empty())
         names.push_back(name);
   }
   for (Section *entry : entries) {
      if (std::to_string(entry->index) == middle)
         return entry;
   }
   deck.complain(origin, address,
                 "no [[" + spec.name + "]] is named " + quoted(middle) +
                     suggest(middle, names, "there are:"));
   return nullptr;
}

// The section and the key of an address; if there are none, nothing and a complaint
static std::pair<Section *, const KeySpec *> find_key(Deck &deck, const Origin &origin,
                                                      const std::string &address) {
   const std::size_t first = address.find('.'), last = address.rfind('.');
   const bool outside = first == std::string::npos;
   const std::string table = outside ? "" : address.substr(0, first);
   const std::string key = outside ? address : address.substr(last + 1);
   const std::string middle = first == last ? "" : address.substr(first + 1, last - first - 1);

   const TableSpec *spec = find_table(table);
   if (!spec) {
      deck.complain(origin, table, unknown_table(table));
      return {};
   }
   const KeySpec *key_spec = spec->find(key);
   if (!key_spec && outside && !key.empty() && find_table(key)) {
      deck.complain(origin, key, "is a table; write " + key + ".key=value");
      return {};
   }
   if (!key_spec) {
      deck.complain(origin, address, unknown_key(*spec, key));
      return {};
   }
   return {find_section(deck, origin, address, *spec, middle), key_spec};
}

static void apply(Deck &deck, const std::string &text) {
   const Origin origin{0, 0, "--set " + text};
   const std::size_t equals = text.find('=');
   const std::string address = trim(text.substr(0, equals));
   if (equals == std::string::npos || address.empty()) {
      deck.complain(origin, address.empty() ? "key" : address, "write table.key=value");
      return;
   }
   const auto [section, key] = find_key(deck, origin, address);
   if (!section)
      return;
   Value value = read_value(trim(text.substr(equals + 1)), *key);
   value.origin = origin;
   section->values[key->name] = value;
}

void apply_overrides(Deck &deck) {
   for (const std::string &text : deck.overrides)
      apply(deck, text);
}

std::string full_key(Deck &deck, const std::string &address) {
   const auto [section, key] = find_key(deck, Origin{0, 0, deck.name}, trim(address));
   return section ? deck.address(*section, key->name) : "";
}

} // namespace rk
